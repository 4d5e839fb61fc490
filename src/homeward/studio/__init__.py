"""The studio: a page to drag landmarks, home and robot on, and to see which estimators notice."""
