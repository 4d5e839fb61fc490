"""Home in the map: resection from home bearings of which some are wrong."""
