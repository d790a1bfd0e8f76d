"""What was found beside what is known to be there, where an arm had something concealed in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.headline import quantity_of, values_of
from estimators.diagnosis.wording import of_several
from limo_driver.pages.markup import UNSAID, columns, percent, section
from limo_driver.physics import Payload, spoken

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.verdict import Finding
    from limo_driver.physics import Effect

_LEAD = (
    "The arm had this in it, and the diagnosis was told of none of it. In brackets: the 95 % "
    "interval."
)


def recovered(concealed: Sequence[Effect], findings: Sequence[Finding], n: int) -> str:
    """Say in a sentence what was concealed in an arm of n joints, and what was found of it."""
    said = "; ".join(_pair(effect, _found(effect, findings), n) for effect in concealed)
    return f"{said[:1].upper()}{said[1:]}."


def beside_the_truth(concealed: Sequence[Effect], findings: Sequence[Finding], n: int) -> str:
    """Return the section of a page with what was concealed and what was found.

    Args:
        concealed: Effects of the arm that the diagnosis was not told of.
        findings: What it found.
        n: Joints of the arm.
    """
    found = [_found(effect, findings) for effect in concealed]
    others = [item for item in findings if not any(item is one for one in found)]
    nothing = "nothing" if others else ""
    rows: dict[str, list[object]] = {
        "concealed": [*(_concealed(effect, n) for effect in concealed), *[nothing] * len(others)],
        "found": [
            _values(item) if item else "not found" for item in (*found, *others)
        ],
        "confidence": [
            percent(item.confidence) if item else UNSAID for item in (*found, *others)
        ],
    }  # fmt: skip
    return section(
        "What was concealed, and what was found", columns(rows, numeric=2), "concealed", _LEAD
    )


def _pair(effect: Effect, found: Finding | None, n: int) -> str:
    if found is None:
        return f"{_concealed(effect, n)} was concealed and not found"
    value = quantity_of(found)
    return f"{_concealed(effect, n)} was concealed, {value or 'it'} was found"


def _found(effect: Effect, findings: Sequence[Finding]) -> Finding | None:
    """Return the finding that is an effect: of its name, at its joints."""
    everywhere = isinstance(effect, Payload)  # at the flange, whichever joints feel it
    return next(
        (
            item
            for item in findings
            if item.effect == effect.name and (everywhere or item.joints == effect.joints)
        ),
        None,
    )


def _concealed(effect: Effect, n: int) -> str:
    """Say what an effect is, how large, and where."""
    sizes = [
        f" of {value:g} {item.unit}"
        for item in effect.parameters()
        if item.is_size and (value := getattr(effect, item.name)) is not None
    ]
    value = sizes[0] if sizes else ""
    where = "the flange" if isinstance(effect, Payload) else of_several(effect.joints, n)
    return f"{spoken(effect.name)}{value} at {where}"


def _values(item: Finding) -> str:
    return f"{spoken(item.effect)}: {quantity_of(item) or values_of(item) or 'found'}"
