"""Tables of an identification: base parameters, and what was identified beside what was stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from estimators.rigid_body.identification import Identification, TermEstimate
from limo_driver.model.units import unit_of

_MOST_DIGITS = 5  # behind the point, of what a table shows
_NOTHING = "–"  # noqa: RUF001  # a dash, as in tables
_PER_LINK = (  # as in the regressor: mass, its first moments, inertia at the joint frame
    *(("m", "kg"), ("mx", "kg m"), ("my", "kg m"), ("mz", "kg m")),
    *((f"I{axes}", "kg m^2") for axes in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
_ROUNDING = 1e-15  # of differences of nominal inertias [SI]
_SMALLEST = 1e-9  # [SI], that a parameter is as large as
_LISTED = 8  # names at most


def joint_table(found: Identification) -> Table:
    """Return errors and joint terms, one row a joint."""
    table = Table(
        title="Joints: in-sample RMSE with base parameters and with physically consistent bodies",
        title_justify="left",
        box=box.SIMPLE_HEAD,  # as narrow as a terminal of 80 columns with every term in it
        padding=0,
        show_edge=False,
    )
    torque = unit_of("N m", found.model.sliding)
    for heading in ("#", f"base\n\n{torque}", f"body\n\n{torque}"):
        table.add_column(heading, justify="right", no_wrap=True)
    names = dict.fromkeys((item.effect, item.parameter, item.unit) for item in found.estimates)
    for effect, parameter, unit in names:
        heading = f"{effect.split('_')[0]}\n{parameter}\n{unit}"
        table.add_column(heading, justify="right", no_wrap=True)
    by_place = {(item.effect, item.joint, item.unit): item for item in found.estimates}
    for j in range(found.model.n):
        cells = [_estimate(by_place.get((effect, j + 1, unit))) for effect, _, unit in names]
        errors = found.fit.rmse[j], found.rmse_consistent[j]
        known = found.fit.effective[j] > 0
        said = [f"{error:.3g}" if known else _NOTHING for error in errors]
        table.add_row(str(j + 1), *said, *cells)
    return table


def _estimate(item: TermEstimate | None) -> str:
    if item is None:
        return _NOTHING
    if item.deviation == 0:
        return "0 (bound)"
    digits = -math.floor(math.log10(item.deviation))
    if not 0 <= digits <= _MOST_DIGITS:
        return f"{item.value:.3g}±{item.deviation:.1g}"
    return f"{item.value:.{digits}f}±{item.deviation:.{digits}f}"


def link_table(found: Identification) -> Table:
    """Return how far each link's inertia moved from the robot description."""
    table = Table(title="Links: change from the robot description", title_justify="left")
    for heading in ("link", "mass [kg]", "was [kg]", "com moved [mm]", "inertia ratio"):
        table.add_column(heading, justify="left" if heading == "link" else "right")
    for link in found.links:
        table.add_row(
            link.link,
            f"{link.mass:.3f}",
            f"{link.mass_nominal:.3f}",
            f"{1e3 * link.com_shift:.1f}",
            f"{link.inertia_ratio:.3g}",
        )
    return table


def base_table(found: Identification) -> Table:
    """Return every base parameter, one row each."""
    table = Table(
        title="Base parameters: what torque can reveal, one standard deviation",
        title_justify="left",
        caption="± counts errors that last and other motion of the kind recorded; physics that is "
        "not modelled can pull every recording alike, which no ± shows",
        caption_justify="left",
    )
    for heading in ("parameter", "value", "nominal", "unit"):
        table.add_column(heading, justify="left" if heading in "parameter unit" else "right")
    for item in base_estimates(found):
        known = f"{item.value:.4g}±{item.deviation:.1g}" if item.is_identified else "not identified"
        table.add_row(item.combination, known, f"{item.nominal:.4g}", item.unit)
    return table


def as_values(found: Identification) -> dict[str, Any]:
    """Return the findings as numbers, lists and texts."""
    return {
        "robot": found.model.name,
        "samples": found.samples,
        "bandwidth": found.rows.bandwidth,
        "base_parameters": found.base.rank,
        "excited": found.fit.excited,
        "condition": found.fit.condition,
        "effective_rows": found.fit.effective.tolist(),
        "inertia_tolerance": found.tolerance,
        "known_to": found.simulation.tolerances.as_values(),
        "torque_units": [unit_of("N m", found.model.sliding, j) for j in range(found.model.n)],
        "rmse": {
            "base_parameters": found.fit.rmse.tolist(),
            "consistent": found.rmse_consistent.tolist(),
        },
        "sign_width": list(found.terms.chosen or ()),
        "joint_terms": [asdict(item) for item in found.estimates],
        "base": [
            asdict(item) | ({} if item.is_identified else {"deviation": None})
            for item in base_estimates(found)
        ],
        "links": [asdict(link) for link in found.links],
        "warnings": list(notes_of(found)),
    }


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
    # Name and unit of every full parameter, in the order of the regressor
    n = found.model.n
    numbers = range(1, found.model.linkage.links + 1)
    links = [(f"{name}_{i}", unit) for i in numbers for name, unit in _PER_LINK]
    terms = [
        (f"{term.parameter}_{j + 1}", unit_of(term.unit, found.model.sliding, j))
        for term in found.terms.all()
        for j in range(n)
    ]
    labels = links + terms
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


def _summand(factor: float, name: str) -> str:
    sign = "-" if factor < 0 else "+"
    size = "" if np.isclose(abs(factor), 1.0) else f"{abs(factor):.4g} "
    return f" {sign} {size}{name}"
