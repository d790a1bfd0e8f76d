"""Every base parameter by name: which combination it is, its value, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.rigid_body.identification import Identification

_PER_LINK = (  # as in the regressor: mass, its first moments, inertia at the joint frame
    *(("m", "kg"), ("mx", "kg m"), ("my", "kg m"), ("mz", "kg m")),
    *((f"I{axes}", "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
_ROUNDING = 1e-15  # of differences of nominal inertias [SI]
_SMALLEST = 1e-9  # [SI], that a parameter is as large as
_LISTED = 8  # names at most


@dataclass(frozen=True)
class BaseEstimate:
    """One base parameter: a parameter, and those that are identifiable only in sum with it."""

    name: str  # of the parameter that stands for it, e.g. my_2 or tau_c_5
    combination: str  # e.g. "my_2 + mz_3 + 0.4200 m_4"
    unit: str
    value: float
    deviation: float  # standard deviation, see `fit_base`; infinite where it is not identified
    nominal: float  # of the robot description; friction and offsets have 0 there

    @property
    def is_identified(self) -> bool:
        """Whether the motion says anything of it."""
        return bool(np.isfinite(self.deviation))


def base_estimates(found: Identification) -> tuple[BaseEstimate, ...]:
    """List the base parameters of an identification, (b,), links first.

    One that is known to no better than its size, and that only from what is believed before any
    motion, is not identified.
    """
    estimates = _fitted(found)
    size = sizes_of(estimates)
    return tuple(
        item if shown or item.deviation <= size[item.name] else replace(item, deviation=np.inf)
        for item, shown in zip(estimates, found.fit.shown, strict=True)
    )


def notes_of(found: Identification) -> tuple[str, ...]:
    """Return the warnings of an identification, and which base parameters are not identified."""
    names = [item.name for item in base_estimates(found) if not item.is_identified]
    if not names:
        return found.warnings
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return *found.warnings, f"not identified by this motion: {', '.join(names[:_LISTED])}{more}"


def _fitted(found: Identification) -> tuple[BaseEstimate, ...]:
    labels = _labels(found)
    base, deviation = found.base, found.fit.deviation
    nominal = base.reduce(found.nominal)
    nominal = np.where(np.abs(nominal) < _ROUNDING, 0.0, nominal)
    estimates: list[BaseEstimate] = []
    for row, (index, mixed) in enumerate(zip(base.independent, base.mixing, strict=True)):
        name, unit = labels[index]
        others = [
            _summand(float(factor), labels[other][0])
            for factor, other in zip(mixed, base.dependent, strict=True)
            if factor
        ]
        value = float(found.fit.parameters[row])
        estimates.append(
            BaseEstimate(
                name,
                name + "".join(others),
                unit,
                value,
                float(deviation[row]),
                float(nominal[row]),
            )
        )
    return tuple(estimates)


def sizes_of(estimates: Sequence[BaseEstimate]) -> dict[str, float]:
    """Return what each parameter is as large as: itself, or what is usual of its unit.

    A product of inertia that is 0 is known, if it is known to be small beside the others.

    Args:
        estimates: Of one identification.

    Returns:
        Sizes by name, in the unit of the parameter.
    """
    of_unit: dict[str, list[float]] = {}
    for item in estimates:
        of_unit.setdefault(item.unit, []).append(max(abs(item.value), abs(item.nominal)))
    usual = {unit: float(np.median(sizes)) for unit, sizes in of_unit.items()}
    return {x.name: max(abs(x.value), abs(x.nominal), usual[x.unit], _SMALLEST) for x in estimates}


def known_of(found: Identification) -> str:
    """Say how many base parameters the motion says something about.

    Args:
        found: With its recordings.
    """
    estimates = base_estimates(found)
    size = sizes_of(estimates)
    known = sum(item.deviation <= size[item.name] for item in estimates)
    return f"{known} of {len(estimates)} base parameters are known to better than their size"


def _labels(found: Identification) -> list[tuple[str, str]]:
    """Return name and unit of every full parameter, in the order of the regressor."""
    n = found.model.n
    numbers = range(1, found.model.linkage.links + 1)
    links = [(f"{name}_{i}", unit) for i in numbers for name, unit in _PER_LINK]
    terms = [
        (f"{term.parameter}_{j + 1}", term.unit) for term in found.terms.all() for j in range(n)
    ]
    return links + terms


def _summand(factor: float, name: str) -> str:
    sign = "-" if factor < 0 else "+"
    size = "" if np.isclose(abs(factor), 1.0) else f"{abs(factor):.4g} "
    return f" {sign} {size}{name}"
