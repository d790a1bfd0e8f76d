"""Hybrid of a rigid-body simulation and a network that learns its residual."""

from estimators.hybrid.model import HybridModel

__all__ = ["HybridModel"]
