"""Home: resection in the map, and which home bearings are inliers."""
