"""Residuals: recordings beside a simulation, their noise, and what is wrong with a log."""
