"""The paper and its tools: model, filters, engine, observability, simulation, studies, planning."""
