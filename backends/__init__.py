"""Backends: how a joint state gets on and off a wire, or out of a simulation."""
