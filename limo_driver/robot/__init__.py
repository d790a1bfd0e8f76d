"""Robots: one cycle at a time, within the safety contract, in real time."""
