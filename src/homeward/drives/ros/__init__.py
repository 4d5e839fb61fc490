"""Logs of ROS 1 and ROS 2, without ROS: their files, their messages, and drives from them."""
