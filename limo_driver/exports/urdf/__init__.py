"""A simulation written into a URDF, and what Drake and Isaac Lab take beside it."""
