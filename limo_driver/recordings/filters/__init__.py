"""Filters and derivatives of motion: of what is recorded, without phase, and live."""
