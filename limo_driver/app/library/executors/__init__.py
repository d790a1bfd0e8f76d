"""Many tasks side by side, in processes or on a cluster of Ray, with the same results."""
