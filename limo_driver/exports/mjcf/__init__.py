"""A simulation written into an MJCF file, with its servos, DC motors and backlash."""
