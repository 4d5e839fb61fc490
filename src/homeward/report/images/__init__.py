"""What is told of panoramas: what two have in common, and what was found along a drive."""
