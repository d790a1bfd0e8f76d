"""Judgement: findings of a fit, their confidence, and what stays unknown."""
