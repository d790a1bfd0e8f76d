"""Fits of the rigid body: rows that count, least squares, and bodies that can exist."""
