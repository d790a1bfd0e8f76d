"""Fitting: the set of effects fitted, refined and given intervals."""
