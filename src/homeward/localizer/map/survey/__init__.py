"""Known landmarks: which of a survey agree with the map, and the pose of its frame there."""
