"""Live session of a robot: samples in as they arrive, poses and velocity commands out."""
