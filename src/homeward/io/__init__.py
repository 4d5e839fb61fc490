"""Safe reading and atomic writing of text files, tables and YAML."""
