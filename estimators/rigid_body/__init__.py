"""Rigid-body estimator: base parameters and physically consistent inertias from recordings."""
