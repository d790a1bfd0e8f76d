"""Training: a challenger from the logs, in a process of its own."""
