"""Pages about studies, plans, the paper and observability."""
