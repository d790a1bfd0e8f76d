"""Dynamics of a chain of bodies: regressor, base parameters, conditioning, inverse dynamics."""
