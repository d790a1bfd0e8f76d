"""Comparison: whether a challenger is better than the champion."""
