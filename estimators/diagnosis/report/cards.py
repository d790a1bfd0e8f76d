"""The findings of a report: a table of many, and a card of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from estimators.diagnosis.headline import is_of_bodies, named, place_of, quantity_of
from estimators.diagnosis.quantities import of_joints, rounded, to_interval
from estimators.diagnosis.settings import LEVEL
from estimators.diagnosis.settings.judgement import WORDING
from estimators.diagnosis.verdict import CONTACT, UNKNOWN, Interval
from limo_driver.model.units import unit_of
from limo_driver.pages.figures import AFTER, curve, layout
from limo_driver.pages.markup import (
    UNSAID,
    folded,
    meter,
    number,
    paragraph,
    percent,
    significant,
    table,
    typeset,
)
from limo_driver.physics import PreslidingHysteresis, display_name
from limo_driver.physics.domain import JointMotion
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from estimators.diagnosis.verdict import Finding, Value, Verdict
    from limo_driver.pages.markup import Charts
    from limo_driver.physics.effect import Effect
    from limo_driver.types import FloatArray

_KINDS = {
    "missing": "missing from the simulation",
    "wrong_parameter": "in the simulation with a wrong value",
}
_NO_EFFECT_OF_THE_ARM = {
    UNKNOWN: "nothing in the catalogue explains it",
    CONTACT: "an event, not a property of the arm; the improved simulation leaves it out",
}
_LISTED = 6  # values of a parameter that are shown before they are folded
_AXES = {"com": ("x", "y", "z"), "inertia": ("xx", "xy", "xz", "yy", "yz", "zz")}  # of bodies
_POINTS = 400  # of a loop, one way


def cards(verdict: Verdict, names: Sequence[str], effects: Sequence[Effect], charts: Charts) -> str:
    """Return the section of the findings; empty if there are none.

    Args:
        verdict: What was found.
        names: Of the recordings.
        effects: Of the improved simulation, of which those with memory are drawn as loops.
        charts: Of the page.
    """
    drawn = {x.joints: x for x in effects if isinstance(x, PreslidingHysteresis) and x.stops()}
    many = len(verdict.findings) > WORDING.listed
    items = "".join(
        _card(number, item, verdict, names, _values(item, verdict, drawn, charts), closed=many)
        for number, item in enumerate(verdict.findings, start=1)
    )
    title = "Findings" if len(verdict.findings) > 1 else "Finding"
    first = _at_a_glance(verdict) if many else ""
    return f'<section id="findings"><h2>{title}</h2>{first}{items}</section>' if items else ""


def _at_a_glance(verdict: Verdict) -> str:
    """Return the findings as a table, a line each, that leads to what is said of them."""
    rows = [
        [
            f'<a href="#finding-{number}">{escape(typeset(_named(item)))}</a>',
            escape(_title_place(item, verdict.names)),
            escape(typeset(quantity_of(item))) or UNSAID,
            meter(item.confidence),
            meter(item.share) if item.share > 0 else UNSAID,
        ]
        for number, item in enumerate(verdict.findings, start=1)
    ]
    beside = "part of the error that it explains"
    return table(("finding", "where", "value, with 95 % interval", "confidence", beside), rows)


def _named(item: Finding) -> str:
    if item.effect == UNKNOWN:
        return "Something unknown"
    name = named(item)
    return f"{name[:1].upper()}{name[1:]}"


def _card(
    order: int,
    item: Finding,
    verdict: Verdict,
    recordings: Sequence[str],
    values: str,
    *,
    closed: bool = False,
) -> str:
    unknown, fit = item.effect == UNKNOWN, verdict.fit
    means = _NO_EFFECT_OF_THE_ARM.get(item.effect) or _KINDS[item.kind]
    title = f"{escape(typeset(_named(item)))} "
    title += f"<span>{escape(_title_place(item, verdict.names))}</span>"
    head = f'<p class="kind">{escape(means)}</p>{paragraph(_sentence(item.evidence), "evidence")}'
    facts = [
        ("confidence", meter(item.confidence)),
    ]
    if drop := _drop(item, verdict):
        facts.append(("held-out RMSE, fitted without → with it", escape(drop)))
    beside = " that tolerances leave" if fit.heldout_rmse_tolerances else ""
    if item.share > 0:  # of a push nothing is: its rows are not scored
        does = "leaves" if unknown else "removes"
        facts.insert(1, (does, f"{meter(item.share)} of the error{beside}"))
    if item.equivalent:
        names = ", ".join(display_name(e) for e in item.equivalent)
        facts.append(("cannot be told from", escape(typeset(names))))
    if where := _where(item, verdict.names, recordings):
        facts.append(("where", where))
    listed = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in facts)
    kind = "card unknown" if unknown else "card"
    body = f"{head}<dl>{listed}</dl>{values}"
    if closed:
        body = f"<details><summary><h3>{title}</h3></summary>{body}</details>"
    else:
        body = f"<h3>{title}</h3>{body}"
    return f'<article id="finding-{order}" class="{kind}">{body}</article>'


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""


def _title_place(item: Finding, names: Sequence[str]) -> str:
    """Say where an effect is, and at which joint it shows where that is another one."""
    place = place_of(item, names)
    shows = item.where.figure.removeprefix("joint-")
    if item.effect == CONTACT or not shows.isdigit() or (int(shows),) == item.joints:
        return place
    return f"{place}, most of all at {of_joints((int(shows),), names)}"


def _drop(item: Finding, verdict: Verdict) -> str:
    pairs = item.heldout_rmse
    if pairs.before == pairs.after:  # nothing is taken off
        return ""
    everywhere = range(1, len(pairs.before) + 1)
    own = () if is_of_bodies(item.effect) else item.joints
    joints = [j for j in own if j in everywhere] or everywhere
    shown = sorted(joints, key=lambda j: pairs.after[j - 1] - pairs.before[j - 1])[: WORDING.listed]
    return "; ".join(
        f"{of_joints((j,), verdict.names)}: {error_of(pairs.before[j - 1])} → "
        f"{error_of(pairs.after[j - 1])} {verdict.unit_at(j)}"
        for j in shown
    )


def _where(item: Finding, names: Sequence[str], recordings: Sequence[str]) -> str:
    sentences = [item.where.region] if item.where.region else []
    of = [f" of {recordings[k - 1]}" for k in item.where.recording if len(recordings) > 1]
    stretches = [f"{a:.1f} to {b:.1f} s" for a, b in item.where.time[:_LISTED]]
    sentences += [text + (of[k] if of else "") for k, text in enumerate(stretches)]
    if item.effect == CONTACT:
        return escape("; ".join(sentences)) + ' (<a href="#pushes">courses</a>)'
    shows = item.where.figure.removeprefix("joint-")
    joints = (int(shows),) if is_of_bodies(item.effect) and shows.isdigit() else item.joints
    joints = [j for j in joints if j <= len(names)]
    links = ", ".join(f'<a href="#joint-{j}">{escape(of_joints((j,), names))}</a>' for j in joints)
    if not sentences:
        return links
    return escape("; ".join(sentences)) + (f" (maps: {links})" if links else "")


def _parameters(item: Finding, stated: Mapping[str, str] | None = None) -> str:
    known_of = stated or {}
    rows = [
        [
            escape(part),
            *([known_of.get(name, UNSAID)] if known_of else []),
            *_value_and_interval(one, _unit(one.unit)),
        ]
        for name, known in item.parameters.items()
        if known.value != () and (known.value != 0 or known.ci95)  # 0: a part not asked for
        for part, one in _components(name, known)
    ]
    heads = ("parameter", *(("stated",) if known_of else ()), "value", "unit", "95 % interval")
    return table(heads, rows) if rows else ""


def _values(
    item: Finding,
    verdict: Verdict,
    drawn: Mapping[tuple[int, ...], PreslidingHysteresis],
    charts: Charts,
) -> str:
    """Return the parameters of a finding; of hysteresis the loop, and its parameters on demand."""
    effect = drawn.get(item.joints) if item.effect == PreslidingHysteresis.name else None
    if effect is None:
        stated = {x.name: f"{x.stated:.4g}" for x in verdict.values_of(item)}
        return _parameters(item, stated) if item.effect != CONTACT else ""
    loop = loop_of(effect)
    push, far = (unit_of(unit, verdict.sliding, effect.joint - 1) for unit in ("N m", "rad"))
    note = (
        f"{significant(loop.height)} {push} high; {percent(LEVEL)} of it has turned "
        f"{significant(loop.width)} {far} after a reversal; {significant(loop.area)} J lost each "
        "time"
    )
    axes = layout(f"distance [{far}]", f"torque [{push}]")
    figure = {"data": [curve(loop.position, loop.torque, "loop", AFTER)], "layout": axes}
    shown = charts.place(figure, "Torque of the hysteresis, to and fro", note)
    return shown + folded("Parameters of its law", _parameters(item))


class Loop(NamedTuple):
    """Torque of hysteresis along a way to and fro, once around."""

    position: FloatArray  # (K,) [rad]
    torque: FloatArray  # (K,) [N m]
    height: float  # [N m], from the lowest to the highest
    width: float  # [rad] after a reversal, in which nearly all of that has turned
    area: float  # [J]


def loop_of(effect: PreslidingHysteresis) -> Loop:
    """Return the loop of a law with memory, between reversals as far apart as it remembers."""
    turn = 2.0 * max(width for _, width in effect.stops())
    reach = 2.0 * turn
    one = np.linspace(0.0, reach, _POINTS)
    way = np.concatenate([one, one[-2::-1], one[1:], one[-2::-1]])
    speed = np.sign(np.gradient(way)) * reach  # one way in a second
    time, still = np.cumsum(np.abs(np.gradient(way))) / reach, np.zeros_like(way)
    torque, _ = effect.advance(effect.initial_state(), JointMotion(time, way, speed, still, still))
    position, around = way[-2 * _POINTS + 1 :], torque[-2 * _POINTS + 1 :]
    height, back = float(np.ptp(around)), around[_POINTS - 1 :]
    turned = int(np.argmax(back <= around.max() - LEVEL * height))
    area = float(np.trapezoid(around, position))
    return Loop(position, around, height, float(reach - position[_POINTS - 1 + turned]), area)


def _components(name: str, known: Interval) -> list[tuple[str, Interval]]:
    """Return a vector as its components; anything else as it is."""
    axes, values, ends = _AXES.get(name), known.value, known.ci95 or ()
    if axes is None or not isinstance(values, tuple) or not len(axes) == len(values) == len(ends):
        return [(name, known)]
    parts = zip(axes, values, ends, strict=True)
    return [(f"{name} {axis}", Interval(one, known.unit, pair)) for axis, one, pair in parts]


def _value_and_interval(known: Interval, unit: str) -> tuple[str, str, str]:
    """Return value, unit and interval, to the digits that the interval leaves."""
    values = list(_numbers(known.value))
    pairs = list(_pairs(known.ci95)) if known.ci95 else []
    ends = [(low, high) for low, high in pairs if low is not None and high is not None]
    if not values or len(values) != len(ends):
        return _value(known.value), unit, _interval(known)
    sentences = [to_interval(value, *pair) for value, pair in zip(values, ends, strict=True)]
    ranges = [f"{low} to {high}" for _, low, high in sentences]
    return _listed([value for value, _, _ in sentences]), unit, _listed(ranges)


def _numbers(value: Value) -> Iterator[float]:
    """Yield the numbers of a value, of a list, or of a list of rows; none of a text."""
    if isinstance(value, (int, float)):
        yield float(value)
    elif not isinstance(value, str):
        for inner in value:
            yield from _numbers(inner)


def _unit(unit: str) -> str:
    return "" if unit == "text" else escape(unit.replace("^2", "\N{SUPERSCRIPT TWO}"))


def _value(value: Value) -> str:
    if isinstance(value, str):
        return escape(typeset(display_name(value)))
    if isinstance(value, (int, float)):
        return number(float(value))
    return _listed([_value(item) for item in value])


def _interval(known: Interval) -> str:
    if not known.ci95:
        return UNSAID
    return _listed([_range(pair) for pair in _pairs(known.ci95)])


def _pairs(nested: tuple[Any, ...]) -> Iterator[tuple[float | None, float | None]]:
    """Yield the intervals of a number, of a list, or of a list of rows."""
    if isinstance(nested[0], (tuple, list)):
        for inner in nested:
            yield from _pairs(inner)
    else:
        yield nested[0], nested[1]


def _range(pair: tuple[float | None, ...]) -> str:
    low, high = (number(np.nan if v is None else float(v)) for v in pair)
    return f"{low} to {high}"


def _listed(texts: list[str]) -> str:
    if len(texts) <= _LISTED:
        return ", ".join(texts)
    return folded(f"{len(texts)} values", ", ".join(texts))


def error_of(value: float) -> str:
    """Return an error to the digits of a report; a dash if it is not known."""
    return rounded(value) if np.isfinite(value) else UNSAID
