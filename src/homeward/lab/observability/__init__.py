"""What bearings can tell apart, and what not: ranks, null spaces, and their meaning in words."""
