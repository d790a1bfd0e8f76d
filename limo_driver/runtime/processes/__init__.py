"""Processes: how they are started, closed and told to end."""
