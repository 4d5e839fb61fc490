"""Report of a plan: page, maps and summary."""
