"""Training of the network: settings, data, who sees which rows, and epochs."""
