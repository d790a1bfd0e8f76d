"""Commands: whether they are set-points in rad that caused the motion, and how joints count."""
