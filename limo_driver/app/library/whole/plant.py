"""The arm of the whole: what its owner believes of it, and what is concealed in it.

It runs in MuJoCo, whose bodies, gears and springs that slip share no code with what estimates and
diagnoses. Every value that is believed is off by what its tolerance allows.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count, takewhile
from typing import Final

import numpy as np

from limo_driver.app.library.demonstrating import BELIEVED, COULOMB
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import (
    CoulombFriction,
    Effect,
    ExternalContact,
    Payload,
    PickedUpLoad,
    PreslidingHysteresis,
    Sensors,
    Simulation,
    ViscousFriction,
)

ROBOT: Final = "iiwa14"
_WIDTHS: Final = (0.001745, 0.005236, 0.01309, 0.02618)  # [rad]: 0.1, 0.3, 0.75 and 1.5 degrees
_SHARES: Final = (0.238, 0.21, 0.147, 0.105)  # of dry friction, that slips at each of them
_TRULY_DRY: Final = 0.3  # of dry friction, that does not build up
_OFF: Final = 2.0  # standard deviations, beyond which nothing believed is off
LOAD: Final = Payload(mass=0.8, com=(0.0, 0.02, 0.08), inertia=(2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3))
WORN: Final = CoulombFriction(joint=4, tau_c=0.8, v_eps=0.002)  # more than is believed
CARRYING: Final = (2, 4, 6)  # joints that lift what is at the flange
PUSH: Final = 10.0  # [N m] about the vertical, at the flange
WRENCH: Final = (0.0, 0.0, 0.0, 0.0, 0.0, PUSH)  # [N, N m]
LONG: Final = 2.5  # [s] of a push
_FIRST_PUSH, _PAUSE, _LAST_PUSH = 5.0, 15.0, 900.0  # [s]


def believed() -> Simulation:
    """Return what the owner believes: rigid body, friction, and hysteresis in every joint."""
    gears: list[Effect] = []
    for joint, dry in enumerate(COULOMB, start=1):
        stiffness = tuple(s * dry / w for s, w in zip(_SHARES, _WIDTHS, strict=True))
        gears += [
            CoulombFriction(joint=joint, tau_c=_TRULY_DRY * dry, v_eps=0.002),
            PreslidingHysteresis(
                joint=joint, law="maxwell_slip", stiffness=stiffness, width=_WIDTHS
            ),
        ]
    rest = [effect for effect in BELIEVED.effects if isinstance(effect, ViscousFriction)]
    sensors = Sensors(torque_noise=BELIEVED.sensors.torque_noise, encoder_resolution=(1e-5,))
    return replace(BELIEVED, effects=(*gears, *rest), sensors=sensors)


def true_arm(seed: int = 0) -> Simulation:
    """Return the arm: off what is believed of it inside tolerances, and with a worn joint."""
    random, known = np.random.default_rng(seed), believed()

    def off(tolerance: float) -> float:
        return 1.0 + tolerance * float(np.clip(random.normal(), -_OFF, _OFF))

    effects: list[Effect] = []
    for effect in known.effects:
        if isinstance(effect, CoulombFriction):
            effects.append(replace(effect, tau_c=off(known.tolerances.friction) * effect.tau_c))
        elif isinstance(effect, ViscousFriction) and effect.f_v is not None:
            effects.append(replace(effect, f_v=off(known.tolerances.friction) * effect.f_v))
        else:
            effects.append(effect)
    inertials = {
        name: _scaled(body, off(known.tolerances.inertia))
        for name, body in known.model.inertials.items()
    }
    return replace(known, effects=(*effects, WORN), inertials=inertials)


def _scaled(body: Inertial, factor: float) -> Inertial:
    """Return a body of another mass and the same shape."""
    xx, xy, xz, yy, yz, zz = (factor * value for value in body.inertia)
    return replace(body, mass=factor * body.mass, inertia=(xx, xy, xz, yy, yz, zz))


def friction_of(simulation: Simulation, joint: int) -> float:
    """Return all Coulomb friction of a joint [N m]."""
    return sum(
        effect.tau_c
        for effect in simulation.effects
        if isinstance(effect, CoulombFriction) and effect.joint == joint
    )


def pushed(arm: Simulation) -> Simulation:
    """Return an arm that is pushed again and again, with pauses."""
    starts = tuple(takewhile(lambda at: at < _LAST_PUSH, count(_FIRST_PUSH, _PAUSE)))
    windows = tuple((at, at + LONG) for at in starts)
    return _with(arm, ExternalContact(windows=windows, wrench=(WRENCH,) * len(windows)))


def loaded(arm: Simulation, start: float | None = None) -> Simulation:
    """Return an arm that carries the load, from a time on [s] or always."""
    if start is None:
        return _with(arm, LOAD)
    load = PickedUpLoad(start=start, mass=LOAD.mass, com=LOAD.com, inertia=LOAD.inertia)
    return _with(arm, load)


def _with(arm: Simulation, effect: Effect) -> Simulation:
    return replace(arm, effects=(*arm.effects, effect))
