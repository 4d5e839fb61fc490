"""The files that logs are kept in: ROS 1 bags, MCAP, sqlite3, and bag folders of them."""
