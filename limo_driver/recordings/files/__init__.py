"""Recordings in files, read in batches however long they are, and written while they grow."""
