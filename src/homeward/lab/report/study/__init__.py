"""What a study leaves behind: a page and figures."""
