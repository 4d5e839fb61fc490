"""What a run leaves behind: its folder, page, tables and log."""
