"""A drive from input to report: estimator runs, scores, tuning, pages and recordings."""
