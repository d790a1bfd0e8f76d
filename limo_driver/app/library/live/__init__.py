"""Work against live robots and the network: runs, and the service of estimates."""
