"""Fleets: recordings by pattern or URL, diagnosed in processes or on a cluster, kept one by one."""
