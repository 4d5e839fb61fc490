"""Square tags in pictures: detection, edge fitting, and bearings with standard deviations."""
