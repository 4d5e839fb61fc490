"""Text files, tables, YAML and names: read with care, written whole or not at all."""
