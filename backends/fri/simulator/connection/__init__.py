"""The way between controller and client: its port, what the network does, and how good it is."""
