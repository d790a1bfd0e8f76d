"""Arms behind drives, simulated forward: the whole arm, or one joint under recorded loads."""
