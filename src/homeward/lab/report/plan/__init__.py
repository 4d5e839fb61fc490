"""What a plan leaves behind: a page, maps and sentences."""
