"""Inference: a joint state in, an estimate out, at the rate of the arm."""
