"""Bayesian linear regression: normal equations, priors, posteriors, and the evidence of a model."""
