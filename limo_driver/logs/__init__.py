"""Logs: MCAP files of what was on the network, and recordings out of them."""
