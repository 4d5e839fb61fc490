"""Output of runs: files, figures and pages."""
