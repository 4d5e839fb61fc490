"""Home bearings from the sightings of a robot that is stationary or turns on the spot at home."""
