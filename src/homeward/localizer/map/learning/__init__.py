"""Learning from solutions of the map: noise, extrinsics, and which landmarks may walk."""
