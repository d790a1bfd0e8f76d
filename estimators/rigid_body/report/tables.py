"""Report of an identification, as tables for a terminal and as plain values for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from estimators.rigid_body.report.base_estimates import base_estimates, notes_of

if TYPE_CHECKING:
    from estimators.rigid_body.identification import Identification, TermEstimate


_MOST_DIGITS = 5  # behind the point, of what a table shows
_NOTHING = "–"  # noqa: RUF001  # a dash, as in tables


def joint_table(found: Identification) -> Table:
    """Return errors and joint terms, one row a joint."""
    table = Table(
        title="Joints: in-sample RMSE with base parameters and with physically consistent bodies",
        title_justify="left",
        box=box.SIMPLE_HEAD,  # as narrow as a terminal of 80 columns with every term in it
        padding=0,
        show_edge=False,
    )
    for heading in ("#", "base\n\nN m", "body\n\nN m"):
        table.add_column(heading, justify="right", no_wrap=True)
    names = dict.fromkeys((item.effect, item.parameter, item.unit) for item in found.estimates)
    for effect, parameter, unit in names:
        heading = f"{effect.split('_')[0]}\n{parameter}\n{unit}"
        table.add_column(heading, justify="right", no_wrap=True)
    by_place = {(item.effect, item.joint): item for item in found.estimates}
    for j in range(found.model.n):
        cells = [_estimate(by_place.get((effect, j + 1))) for effect, _, _ in names]
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
        "known_to": asdict(found.simulation.tolerances),
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
