"""What the name of a column says: which quantity of which joint, and in which unit."""
