"""Reading a verdict, under the name that programs import."""

from estimators.diagnosis.quantities import verdict_in

__all__ = ["verdict_in"]
