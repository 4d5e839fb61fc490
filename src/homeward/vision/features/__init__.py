"""What stands out in a panorama, and where it lies in another one."""
