"""Hypotheses: what could act where, the torque of it, and the set of most evidence."""
