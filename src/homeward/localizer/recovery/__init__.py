"""Failure detection and recovery: kidnapping, slip, lost odometry; relocalisation in the map."""
