"""Retraining: from drift to a better champion, or back."""
