"""Nuisance: what may differ from the simulation without being missing physics.

Inertias and friction are known to the tolerances of `sim.yaml`; sensors have a little offset and
lag. Each is a column with a prior deviation. Freely refitted, they would swallow nearly all of an
elasticity or a backlash; ignored, they would look like physics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.evidence import Prior, joined
from estimators.diagnosis.hypotheses import UNIT_DELAY
from estimators.diagnosis.responses import response
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics import TimeDelay, TorqueOffset

if TYPE_CHECKING:
    from estimators.diagnosis.columns import Columns
    from estimators.diagnosis.improvement import Enter, Improvement
    from estimators.diagnosis.observations import Observations
    from limo_driver.model import Inertial
    from limo_driver.physics import Parameter
    from limo_driver.types import FloatArray

SENSOR_LAG = 3e-4  # [s], 1 sigma: of a torque sensor's own filter against the encoder's
WIDTH_TOLERANCE = 0.7  # relative, of the width of a smoothed sign
_STEP = 0.05  # relative, for derivatives by a parameter
_LEAST_LEVER = 0.01  # [m], scale of a centre of mass that lies on an axis
_WIDTHS = {"v_eps"}  # parameters that smooth rather than describe


@dataclass(frozen=True)
class Nuisance:
    """Columns inside tolerances, with how to enter each group into a simulation."""

    names: tuple[str, ...]
    prior: Prior
    nominal: FloatArray  # value that a coefficient of 1 adds, or 1
    groups: tuple[tuple[slice, Enter | None], ...]

    def enter(self, improvement: Improvement, coefficients: FloatArray) -> None:
        """Enter fitted coefficients (c,)."""
        for rows, enter in self.groups:
            if enter is not None:
                enter(improvement, coefficients[rows])


def nuisance_of(observed: Observations, columns: Columns, floor: FloatArray) -> Nuisance:
    """Add the nuisance columns to the table.

    Args:
        observed: Recordings and simulation.
        columns: The table.
        floor: Rough noise floor of each joint (n,) [N m].
    """
    parts = [
        *_inertias(observed, columns),
        *_parameters(observed, columns),
        *_sensors(observed, columns, floor),
    ]
    sizes = np.cumsum([0, *(part.prior.index.size for part in parts)])
    return Nuisance(
        tuple(name for part in parts for name in part.names),
        joined(*(part.prior for part in parts)),
        np.concatenate([part.nominal for part in parts]),
        tuple(
            (slice(start, stop), part.enter)
            for part, start, stop in zip(parts, sizes[:-1], sizes[1:], strict=True)
        ),
    )


@dataclass(frozen=True)
class _Part:
    names: tuple[str, ...]
    prior: Prior
    nominal: FloatArray
    enter: Enter | None


def _inertias(observed: Observations, columns: Columns) -> list[_Part]:
    Y, model = observed.regressor, observed.simulation.model
    parts: list[_Part] = []
    for link, name in enumerate(model.link_names):
        scale = relative_inertia(model.inertials[name])
        own = Y[: link + 1, :, PER_LINK * link : PER_LINK * (link + 1)] @ scale
        index = columns.add(range(link + 1), own)
        deviation = np.full(PER_LINK, observed.simulation.tolerances.inertia)
        parts.append(
            _Part(
                tuple(f"{part} of {name}" for part in _INERTIAL_NAMES),
                Prior.free(index, deviation),
                np.ones(PER_LINK),
                _mover(link, scale),
            )
        )
    return parts


_INERTIAL_NAMES = ("mass", *(f"com {axis}" for axis in "xyz"), *(f"inertia {i}" for i in range(6)))


def _mover(link: int, scale: FloatArray) -> Enter:
    return lambda improvement, c: improvement.move_inertia(link, scale @ c)


def relative_inertia(body: Inertial) -> FloatArray:
    """Return d(m, m c, I at the joint frame) / d(relative m, c, I at the com), (10, 10).

    A component of the centre of mass is relative to the distance of that centre.
    """
    m, c = body.mass, np.array(body.com)
    tensor = body.tensor()
    scale = np.zeros((PER_LINK, PER_LINK))
    at_origin = _point(m, c)
    scale[0, 0], scale[1:4, 0], scale[4:, 0] = m, m * c, at_origin
    lever = np.full(3, max(float(np.linalg.norm(c)), _LEAST_LEVER))
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = lever[axis]
        scale[1 + axis, 1 + axis] = m * lever[axis]
        ahead, behind = (_point(m, c + sign * 0.01 * d) for sign in (1, -1))
        scale[4:, 1 + axis] = (ahead - behind) / 0.02
    moments = np.diag(tensor)
    for column, (i, k) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
        size = np.sqrt(moments[i] * moments[k]) * (1.0 if i == k else 0.3)
        scale[4 + column, 4 + column] = size
    return scale


def _point(m: float, c: FloatArray) -> FloatArray:
    tensor = m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array(
        [tensor[0, 0], tensor[0, 1], tensor[1, 1], tensor[0, 2], tensor[1, 2], tensor[2, 2]]
    )


def _parameters(observed: Observations, columns: Columns) -> list[_Part]:
    parts: list[_Part] = []
    for place, effect in enumerate(observed.simulation.effects):
        for known in effect.parameters():
            value: Any = getattr(effect, known.name)
            if not can_scale(known) or not value:
                continue
            joints, values = derivative(observed, place, known.name)
            width = known.name in _WIDTHS
            tolerance = WIDTH_TOLERANCE if width else observed.simulation.tolerances.friction
            joint = getattr(effect, "joint", None)
            where = "" if joint is None else f" of joint {joint}"
            parts.append(
                _Part(
                    (f"{effect.name} {known.name}{where}",),
                    Prior.free(columns.add(joints, values[:, :, None]), np.array([tolerance])),
                    np.array([float(value)]),
                    _reviser(place, known.name, width=width),
                )
            )
    return parts


def can_scale(known: Parameter) -> bool:
    """Say whether a parameter is a size: a number that is neither a shape nor a sign."""
    return known.is_number and (known.unit != "1" or known.name in {"coefficient", "gain"})


def _reviser(place: int, name: str, *, width: bool) -> Enter:
    if width:  # its logarithm is what is linear
        return lambda improvement, c: improvement.revise(
            place, name, float(np.clip(np.exp(c[0]), 0.2, 5.0) - 1.0)
        )
    return lambda improvement, c: improvement.revise(place, name, float(c[0]))


def derivative(observed: Observations, place: int, name: str) -> tuple[tuple[int, ...], FloatArray]:
    """Return what a relative change of 1 of an effect's parameter adds, to first order.

    Returns:
        Joints (0-based) on which it acts, and the values (len(joints), K) [N m].
    """
    effect: Any = observed.simulation.effects[place]
    value = getattr(effect, name)
    ahead = response(replace(effect, **{name: value * (1 + _STEP)}), observed)
    behind = response(replace(effect, **{name: value * (1 - _STEP)}), observed)
    if ahead.joints != behind.joints:
        raise AssertionError("an effect acts on the same joints whatever its size")
    return ahead.joints, (ahead.values - behind.values) / (2 * _STEP)


def _sensors(observed: Observations, columns: Columns, floor: FloatArray) -> list[_Part]:
    parts: list[_Part] = []
    for j in range(observed.n):
        lag = response(TimeDelay(joint=j + 1, delay=UNIT_DELAY), observed)
        index = columns.add(lag.joints, lag.values[:, :, None])
        deviation = np.array([SENSOR_LAG / UNIT_DELAY])
        parts.append(
            _Part((f"lag of sensor {j + 1}",), Prior.free(index, deviation), np.ones(1), None)
        )
        offset = response(TorqueOffset(joint=j + 1, offset=1.0), observed)
        index = columns.add(offset.joints, offset.values[:, :, None])
        parts.append(
            _Part(
                (f"offset of sensor {j + 1}",),
                Prior.free(index, 0.3 * floor[j : j + 1]),
                np.ones(1),
                None,
            )
        )
    return parts
