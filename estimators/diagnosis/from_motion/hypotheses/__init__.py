"""What an arm may have beyond what is stated of it, and the search for it."""
