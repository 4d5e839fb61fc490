"""Square tags in pictures: found, their edges fitted, and their bearings with honest deviations."""
