"""What a solution of the map tells of noise, of the camera's place, and of who may walk."""
