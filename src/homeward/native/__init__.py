"""Programs in C, compiled when first needed, for the processor that runs them."""
