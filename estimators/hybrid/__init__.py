"""Hybrid of a rigid-body simulation and a network that learns what it leaves unexplained."""

from estimators.hybrid.model import HybridModel

__all__ = ["HybridModel"]
