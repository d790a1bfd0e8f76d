"""Machine code of compiled functions: what it comes from, and where it is kept."""
