"""Commands for studies, plans, observability and the paper's cases."""
