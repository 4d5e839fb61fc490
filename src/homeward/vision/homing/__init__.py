"""Visual homing: the direction home from home's own panorama, and the pose near home."""
