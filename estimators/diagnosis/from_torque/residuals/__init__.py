"""Residuals: recordings minus a simulation, their noise, and mistakes in logs."""
