"""Home bearings out of a drive: what the camera saw while the robot stood, or turned, at home."""
