"""Parameter: a number, a list or a text of an effect, with its unit, its bounds and its use."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Literal

import numpy as np

TEXT, JOINT = "text", "joint"  # units of parameters that are no physical quantity


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before any data."""

    name: str
    unit: str  # or "text", or "joint" for the 1-based number of another joint
    lower: float
    upper: float
    description: str
    is_list: bool = False
    optional: bool = False
    length: int | None = None  # of a list, where it is fixed
    columns: int | None = None  # of each row, for a list of rows
    adds: bool = False  # of two effects at one place, the sum of these makes one effect
    smooths: bool = False  # a width that smooths rather than describes; its logarithm is linear
    inverse: bool = False  # the torque is linear in its inverse
    scales: bool = False  # a size, though its unit is 1
    chosen: bool = False  # where or when something is, which no data are asked for
    deviation: float | Literal["largest"] | None = None  # before any data; None: its own value

    @property
    def is_number(self) -> bool:
        """Whether the parameter is one real number, which can be fitted."""
        return not self.is_list and self.unit not in {TEXT, JOINT}

    @property
    def is_size(self) -> bool:
        """Whether it is a number that is neither a shape nor a sign."""
        return self.is_number and (self.unit != "1" or self.scales)


def parameter(  # noqa: ANN201  # a dataclass field, whose type is the annotation's
    unit: str,
    description: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    default: Any = MISSING,  # noqa: ANN401  # of the field's own type
    length: int | None = None,
    columns: int | None = None,
    adds: bool = False,
    smooths: bool = False,
    inverse: bool = False,
    scales: bool = False,
    chosen: bool = False,
    deviation: float | Literal["largest"] | None = None,
):
    """Declare a parameter of an effect as a dataclass field.

    Args:
        unit: SI, as in "N m/rad"; "text" and "joint" for what is no quantity.
        description: In a few words.
        lower: Least value, in the unit.
        upper: Largest value.
        default: Makes it optional in `sim.yaml`.
        length: Of a list, where it is fixed.
        columns: Of each row, for a list of rows.
        adds: Two effects at one place are one effect with the sum of these.
        smooths: It is the width of a smoothed sign, known to be there and not how wide.
        inverse: The torque is linear in its inverse, as a stiffness that winds up.
        scales: It is a size, though its unit is 1.
        chosen: It says where or when something is, and is not estimated.
        deviation: How far it may be off before any data, in the unit; "largest" of a list as far as
            its largest entry. Where nothing is said, as far as it is large, and a 0 stays.
    """
    known = {
        "unit": unit,
        "lower": lower,
        "upper": upper,
        "description": description,
        "length": length,
        "columns": columns,
        "adds": adds,
        "smooths": smooths,
        "inverse": inverse,
        "scales": scales,
        "chosen": chosen,
        "deviation": deviation,
    }
    return field(default=default, metadata=known)


def parameters_of(effect: Any) -> tuple[Parameter, ...]:  # noqa: ANN401  # a dataclass
    """Return the parameters that a dataclass declares, in their order."""
    return tuple(
        Parameter(
            name=item.name,
            is_list="tuple" in str(item.type),
            optional=item.default is not MISSING,
            **item.metadata,
        )
        for item in fields(effect)
        if "unit" in item.metadata
    )
