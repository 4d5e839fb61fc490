"""The node of ROS 2; rclpy comes from the robot's own ROS."""
