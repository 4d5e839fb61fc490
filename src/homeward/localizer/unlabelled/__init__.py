"""Landmarks without ids: a front of the localiser that gives sightings the ids of its map."""
