"""Judgement: what of a fit is named, how sure that is, and what stays unknown."""
