"""Where programs import the port of the simulated controller from."""
