"""Known landmarks: what of a survey agrees with the map, and where its frame lies there."""
