"""Interactive plots of a run's page, and the data of its slider."""
