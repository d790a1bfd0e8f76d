"""Descriptions of robots: URDF and MJCF files, read into one form with what each joint states."""
