"""Logs of ROS 1 and ROS 2, without ROS: their containers, their messages, and drives from them."""
