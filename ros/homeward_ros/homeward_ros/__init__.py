"""Launch files, parameters and displays of homeward."""
