"""Separation: the motion in which two effects differ most."""
