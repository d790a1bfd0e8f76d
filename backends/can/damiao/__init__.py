"""Damiao motors in MIT mode: their frames, set-up and states."""
