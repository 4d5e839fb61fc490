"""Import of drives from tables with any columns, separators and units."""
