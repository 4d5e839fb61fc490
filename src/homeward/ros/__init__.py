"""ROS 2 node; rclpy comes from the robot's ROS installation."""
