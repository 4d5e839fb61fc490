"""On a robot, live: samples in as they come, a pose and a command home out."""
