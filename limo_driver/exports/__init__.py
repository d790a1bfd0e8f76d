"""Simulations written back into the files of other simulators: only what was found changes."""
