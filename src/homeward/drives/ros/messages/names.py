"""Names of message types that have a meaning of their own here."""

ODOMETRY = "homeward_msgs/msg/Odometry"
BEARINGS = "homeward_msgs/msg/Bearings"
POSE = "homeward_msgs/msg/Pose"
PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
