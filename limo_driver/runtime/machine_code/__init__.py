"""Machine code of compiled functions: its sources, and the files that keep it."""
