"""Selection: which set of effects the recordings speak for."""
