"""Hypotheses: what could act where, and the torque that a recording would show of it."""
