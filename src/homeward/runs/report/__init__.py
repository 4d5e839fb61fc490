"""What a run and a study leave behind: files, figures, pages."""
