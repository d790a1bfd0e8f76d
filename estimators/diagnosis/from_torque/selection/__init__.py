"""Selection: the set of effects of most evidence."""
