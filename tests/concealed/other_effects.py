"""Effects outside the catalogue, and values that are known but wrong."""

from collections.abc import Callable
from dataclasses import replace

import drive as drive_
import numpy as np
from acquisition import Course
from arm import N
from draft import Draft, Place
from known_effects import KNOWN
from world import World

_FACTORS = (0.4, 0.5, 2.0, 2.5)  # value stated over the true one: at least 3.3 sigma of it off


def coupled_bearings(at: Place) -> Draft:
    """Dry friction goes with the load of another joint."""
    source = int(at.random.choice([k for k in (1, 3) if k != at.j]))
    return _neighbour(at.j, source, at.floor / 10, 0.1, "neighbour_load", "coupled_bearings")


def thermal_neighbour(at: Place) -> Draft:
    """Dry friction grows as another joint warms by its own motion."""
    source = int(at.random.choice([k for k in range(N) if k != at.j]))
    time = at.random.uniform(4.0, 10.0)
    made = _neighbour(at.j, source, 2 * at.floor, 3.0, "neighbour_heat", "thermal_neighbour")

    def change(w: World, amplitude: float) -> World:
        return made.change(w.with_drive(source, warming=time), amplitude)

    return replace(made, change=change)


def hose(at: Place) -> Draft:
    """A hose wound over two joints pulls with the product of their angles."""
    source = int(at.random.choice([k for k in range(N) if k != at.j]))
    return _neighbour(at.j, source, 2 * at.floor, 6.0, "neighbour_hose", "hose")


def _neighbour(j, source, guess, largest, name, law):
    return Draft(
        "unknown", (j + 1,), guess, largest,
        lambda w, x: w.with_drive(j, neighbour=source, **{name: x}), law=law,
    )  # fmt: skip


def dwell_stiction(at: Place) -> Draft:
    """Breakaway torque grows with the time at rest and goes over a distance."""
    time, distance = at.random.uniform(0.1, 0.5), at.random.uniform(0.05, 0.3)
    return Draft(
        "unknown", (at.j + 1,), 5 * at.floor, 6.0,
        lambda w, x: w.with_drive(at.j, dwell=x, dwell_time=time, dwell_distance=distance),
        law="dwell_stiction",
    )  # fmt: skip


def periodic_disturbance(at: Place) -> Draft:
    """A pump or fan nearby."""
    return _course(at, "periodic", 1 / at.random.uniform(0.5, 4.0))


def torque_jumps(at: Place) -> Draft:
    """A loose contact in the sensor."""
    made = _course(at, "jumps", at.random.uniform(2.0, 6.0))
    return replace(made, equivalent=("torque_drift",))


def _course(at, kind, scale):
    seed = int(at.random.integers(2**31))

    def change(w: World, amplitude: float) -> World:
        course = Course(at.j, kind, amplitude, scale, seed)
        return replace(w, sensing=replace(w.sensing, courses=(*w.sensing.courses, course)))

    return Draft("unknown", (at.j + 1,), 1.5 * at.floor, 5.0, change, law=kind, predictable=False)


def bent_sensor(at: Place) -> Draft:
    """A torque sensor whose characteristic is quadratic."""
    sign = at.random.choice([-1.0, 1.0])
    return Draft(
        "unknown", (at.j + 1,), at.floor / 20, 0.02,
        lambda w, x: replace(w, sensing=w.sensing.at("curve", at.j, sign * x)), law="bent_sensor",
    )  # fmt: skip


UNKNOWN: dict[str, Callable] = {
    f.__name__: f
    for f in (
        coupled_bearings, thermal_neighbour, hose, dwell_stiction, periodic_disturbance,
        torque_jumps, bent_sensor,
    )
}  # fmt: skip


def wrong_coulomb(at: Place) -> Draft:
    return _wrong_friction(at, "coulomb", "tau_c")


def wrong_viscous(at: Place) -> Draft:
    return _wrong_friction(at, "viscous", "f_v")


def _wrong_friction(at: Place, name: str, parameter: str) -> Draft:
    factor = float(at.random.choice(_FACTORS))

    def change(w: World, _: float) -> World:
        values = getattr(w.nominal, name).copy()
        values[at.j] *= factor
        return w.with_nominal(**{name: values}, wrong=w.nominal.wrong | {(name, at.j)})

    true = {parameter: float(at.world.drive[name][at.j])}
    return _fixed(f"{name}_friction", (at.j + 1,), change, true, parameter)


def wrong_link(at: Place) -> Draft:
    link = max(at.j, 1)
    factor = 1 + float(at.random.choice([-0.35, -0.25, 0.25, 0.35]))

    def change(w: World, _: float) -> World:
        mass = w.nominal.arm.mass.copy()
        mass[link] *= factor
        return w.with_nominal(arm=w.nominal.arm._replace(mass=mass))

    same = ("payload",) if link == N - 1 else ()
    true = {"mass": float(at.world.arm.mass[link])}
    return replace(_fixed("link_inertia", (link + 1,), change, true, "mass"), equivalent=same)


def _fixed(effect, joints, change, true, wrong):
    return Draft(
        effect, joints, 1.0, 1.0, change, lambda _: true, kind="wrong_parameter", wrong=wrong
    )


def wrong_armature(at: Place) -> Draft:
    return _in_file(KNOWN["armature"](at), at.random, "inertia")


def wrong_gain(at: Place) -> Draft:
    return _in_file(KNOWN["torque_gain"](at), at.random, "gain")


def wrong_stribeck(at: Place) -> Draft:
    speed = float(np.exp(at.random.uniform(np.log(0.01), np.log(0.06))))
    made = Draft(
        "stribeck_friction", (at.j + 1,), 2 * at.floor, 6.0,
        lambda w, x: w.with_drive(
            at.j, stribeck=x, stribeck_speed=speed, stribeck_law=drive_.GAUSS),
        lambda x: {"tau_s": x, "v_s": speed, "delta": 2.0},
    )  # fmt: skip
    return _in_file(made, at.random, "tau_s")


def wrong_elasticity(at: Place) -> Draft:
    made = Draft(
        "joint_elasticity", (at.j + 1,), 1e-3 * at.floor, 1e-3,
        lambda w, x: w.with_drive(at.j, stiffness=1 / x), lambda x: {"stiffness": 1 / x},
    )  # fmt: skip
    return _in_file(made, at.random, "stiffness")


def _in_file(made: Draft, random: np.random.Generator, name: str) -> Draft:
    """Put the effect into the nominal file, with one value wrong by a factor."""
    factor = float(random.choice(_FACTORS))
    joint = made.joints[0]

    def change(w: World, amplitude: float) -> World:
        entry = {"effect": made.effect, "joint": joint} | made.parameters(amplitude)
        entry[name] = float(entry[name]) * factor
        w = made.change(w, amplitude)
        return w.with_nominal(entries=(*w.nominal.entries, entry))

    known = 1 / factor if name == "stiffness" else factor
    return replace(
        made, change=change, kind="wrong_parameter", scale=abs(1 - known), wrong=name
    )  # fmt: skip


WRONG: dict[str, Callable] = {
    f.__name__: f
    for f in (
        wrong_coulomb, wrong_viscous, wrong_link, wrong_armature, wrong_gain, wrong_stribeck,
        wrong_elasticity,
    )
}  # fmt: skip
