"""Bags of ROS: joint states out of them, and the layouts that tools show them in."""
