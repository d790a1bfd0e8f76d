"""Findings of drives, judged on held-out motion: what each removes, and what does not show."""
