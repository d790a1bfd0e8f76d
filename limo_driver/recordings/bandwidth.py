"""The bandwidth of filters where none is told: one for all that compares motion and torque."""

from typing import Final

BANDWIDTH: Final = 10.0  # [Hz] of the zero-phase filters on motion and torque
