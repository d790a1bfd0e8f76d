"""Effects of the catalogue, each with the plant's own equation.

A function draws everything about an effect but its amplitude."""

from collections.abc import Callable
from dataclasses import replace

import drive as drive_
import numpy as np
import presliding
from acquisition import Course
from arm import N, add_body
from draft import Draft, Place
from world import Push, World

_WRISTS = ((4, 5), (5, 6), (4, 6))


def link_inertia(at: Place) -> Draft:
    link = max(at.j, 1)
    direction = at.random.normal(size=3)
    com = at.world.arm.com[link] + 0.05 * direction / np.linalg.norm(direction)

    def change(w: World, mass: float) -> World:
        inertia = mass * 0.03**2 * np.eye(3)
        return replace(w, arm=add_body(w.arm, link, mass, com, inertia))

    same = ("payload",) if link == N - 1 else ()
    return Draft("link_inertia", (link + 1,), 0.05 + 30 * at.floor, 4.0, change, equivalent=same)


def payload(at: Place) -> Draft:
    com = np.array([*at.random.uniform(-0.03, 0.03, 2), at.random.uniform(0.06, 0.15)])

    def change(w: World, mass: float) -> World:
        inertia = mass * np.diag(random_box)
        return replace(w, arm=add_body(w.arm, N - 1, mass, com, inertia))

    random_box = at.random.uniform(0.02, 0.06, 3) ** 2 * 2 / 3
    return Draft(
        "payload", (N,), 10 * at.floor, 12.0, change,
        lambda mass: {"mass": mass, "com": com.tolist()}, equivalent=("link_inertia",),
    )  # fmt: skip


def gravity_direction(at: Place) -> Draft:
    heading = at.random.uniform(0, 2 * np.pi)

    def gravity(tilt: float) -> np.ndarray:
        side = np.sin(tilt) * np.array([np.cos(heading), np.sin(heading)])
        return -9.81 * np.array([*side, np.cos(tilt)])

    return Draft(
        "gravity_direction", tuple(range(1, N + 1)), at.floor / 10, 0.3,
        lambda w, tilt: replace(w, arm=w.arm._replace(gravity=gravity(tilt))),
        lambda tilt: {"gravity": gravity(tilt).tolist()},
    )  # fmt: skip


def armature(at: Place) -> Draft:
    return Draft(
        "armature", (at.j + 1,), 4 * at.floor, 3.0,
        lambda w, inertia: w.with_drive(at.j, armature=inertia),
        lambda inertia: {"inertia": inertia},
    )  # fmt: skip


def coulomb_friction(at: Place) -> Draft:
    def change(w: World, tau_c: float) -> World:
        coulomb = w.nominal.coulomb.copy()
        coulomb[at.j] = 0.0
        return w.with_drive(at.j, coulomb=tau_c).with_nominal(coulomb=coulomb)

    return Draft(
        "coulomb_friction", (at.j + 1,), 1.1 * at.floor, 6.0, change,
        lambda tau_c: {"tau_c": tau_c},
    )  # fmt: skip


def viscous_friction(at: Place) -> Draft:
    def change(w: World, f_v: float) -> World:
        viscous = w.nominal.viscous.copy()
        viscous[at.j] = 0.0
        return w.with_drive(at.j, viscous=f_v).with_nominal(viscous=viscous)

    return Draft(
        "viscous_friction", (at.j + 1,), 5 * at.floor, 12.0, change, lambda f_v: {"f_v": f_v},
    )  # fmt: skip


def asymmetric_friction(at: Place) -> Draft:
    side = at.random.choice([-1.0, 1.0])
    return Draft(
        "asymmetric_friction", (at.j + 1,), 2 * at.floor, 4.0,
        lambda w, excess: w.with_drive(at.j, one_sided=excess, side=side),
        equivalent=("torque_offset",),
    )  # fmt: skip


def stribeck_friction(at: Place) -> Draft:
    law = int(at.random.integers(3))
    speed = float(np.exp(at.random.uniform(np.log(0.01), np.log(0.06))))
    delta = {drive_.GAUSS: 2.0, drive_.TUSTIN: 1.0}.get(law)

    def parameters(tau_s: float) -> dict:
        return {} if delta is None else {"tau_s": tau_s, "v_s": speed, "delta": delta}

    return Draft(
        "stribeck_friction", (at.j + 1,), 2 * at.floor, 4.0,
        lambda w, tau_s: w.with_drive(at.j, stribeck=tau_s, stribeck_speed=speed, stribeck_law=law),
        parameters, law=("gauss", "tustin", "lorentz")[law],
    )  # fmt: skip


def presliding_hysteresis(at: Place) -> Draft:
    law = str(at.random.choice(list(presliding.LAWS)))
    width = np.exp(at.random.uniform(np.log(2e-3), np.log(2e-2)))
    fields = presliding.draw(law, 1.0, width, at.random)
    converts = bool(at.random.random() < 0.6)  # friction known in height, but not how it builds up

    def change(w: World, sliding: float) -> World:
        coulomb = w.nominal.coulomb.copy()
        coulomb[at.j] += sliding * converts
        made = w.with_drive(at.j, **(fields | {"sliding": sliding}))
        return made.with_nominal(coulomb=coulomb)

    return Draft("presliding_hysteresis", (at.j + 1,), 2 * at.floor, 4.0, change, law=law)


def load_dependent_friction(at: Place) -> Draft:
    side = float(at.random.choice([0.0, 0.0, 1.0, -1.0]))
    variant = {0.0: "absolute", 1.0: "positive", -1.0: "negative"}[side]
    return Draft(
        "load_dependent_friction", (at.j + 1,), at.floor / 4, 0.4,
        lambda w, k: w.with_drive(at.j, load=k, load_side=side),
        lambda k: {"coefficient": k, "variant": variant}, law=variant,
    )  # fmt: skip


def position_dependent_friction(at: Place) -> Draft:
    if at.random.random() < 0.5:
        place, width = at.random.uniform(-0.8, 0.8), at.random.uniform(0.2, 0.6)
        return Draft(
            "position_dependent_friction", (at.j + 1,), 2 * at.floor, 4.0,
            lambda w, a: w.with_drive(at.j, bump=(a, place, width)), law="bump",
        )  # fmt: skip
    share, cycles = at.random.dirichlet(np.ones(3)), np.array([1.0, 2.0, 3.0])
    phase = at.random.uniform(0, 2 * np.pi, 3)

    def change(w: World, amplitude: float) -> World:
        return w.with_drive(at.j, where=np.stack([amplitude * share, cycles, phase], axis=1))

    return Draft(
        "position_dependent_friction", (at.j + 1,), 2 * at.floor,
        0.6 * float(at.world.drive["coulomb"][at.j]), change, law="fourier",
    )  # fmt: skip


def temperature_dependent_friction(at: Place) -> Draft:
    time = at.random.uniform(15.0, 45.0)
    return Draft(
        "temperature_dependent_friction", (at.j + 1,), 3 * at.floor, 4.0,
        lambda w, excess: w.with_drive(at.j, cold=excess, warming=time),
    )  # fmt: skip


def quadratic_drag(at: Place) -> Draft:
    power = at.random.uniform(1.85, 2.15)
    return Draft(
        "quadratic_drag", (at.j + 1,), 30 * at.floor, 30.0,
        lambda w, c: w.with_drive(at.j, drag=c, power=power),
    )  # fmt: skip


def backlash(at: Place) -> Draft:
    stiffness = 4e5 if at.j < 4 else 1e5
    return Draft(
        "backlash", (at.j + 1,), at.floor / 20, 0.03,
        lambda w, gap: w.with_drive(at.j, stiffness=stiffness, gap=gap),
        lambda gap: {"gap": gap},
    )  # fmt: skip


def joint_elasticity(at: Place) -> Draft:
    hardening = float(at.random.choice([0.0, at.random.uniform(0, 3e3)]))

    def change(w: World, compliance: float) -> World:
        return w.with_drive(at.j, stiffness=1 / compliance, hardening=hardening)

    def parameters(compliance: float) -> dict:
        return {} if hardening else {"stiffness": 1 / compliance}

    return Draft("joint_elasticity", (at.j + 1,), 1e-3 * at.floor, 1e-3, change, parameters)


def torque_ripple(at: Place) -> Draft:
    cycles = float(np.round(np.exp(at.random.uniform(np.log(8), np.log(100)))))
    second = at.random.choice([0.0, at.random.uniform(0.2, 0.5)])
    phase = at.random.uniform(0, 2 * np.pi, 2)

    def change(w: World, amplitude: float) -> World:
        rows = [(amplitude, cycles, phase[0]), (second * amplitude, 2 * cycles, phase[1])]
        return w.with_drive(at.j, ripple=np.array([*rows, (0.0, 1.0, 0.0)]))

    return Draft(
        "torque_ripple", (at.j + 1,), 1.5 * at.floor, 3.0, change,
        lambda a: {"cycles_per_rev": [cycles], "amplitude": [a]},
    )  # fmt: skip


def torque_offset(at: Place) -> Draft:
    sign = at.random.choice([-1.0, 1.0])
    return _sensed(
        "torque_offset", at.j, at.floor, 5.0, "offset", sign, equivalent=("asymmetric_friction",)
    )


def torque_gain(at: Place) -> Draft:
    return _sensed("torque_gain", at.j, at.floor / 3, 0.4, "gain", at.random.choice([-1.0, 1.0]))


def encoder_offset(at: Place) -> Draft:
    sign = at.random.choice([-1.0, 1.0])
    return _sensed("encoder_offset", at.j, at.floor / 30, 0.1, "encoder_offset", sign)


def _sensed(effect, j, guess, largest, name, sign, **more):
    key = "gain" if name == "gain" else "offset"
    return Draft(
        effect, (j + 1,), guess, largest,
        lambda w, x: replace(w, sensing=w.sensing.at(name, j, sign * x)),
        lambda x: {key: sign * x}, **more,
    )  # fmt: skip


def torque_crosstalk(at: Place) -> Draft:
    source = int(at.random.choice([k for k in (0, 1, 2, 3) if k != at.j]))
    sign = at.random.choice([-1.0, 1.0])

    def change(w: World, gain: float) -> World:
        matrix = w.sensing.crosstalk.copy()
        matrix[at.j, source] += sign * gain
        return replace(w, sensing=replace(w.sensing, crosstalk=matrix))

    return Draft(
        "torque_crosstalk", (at.j + 1,), at.floor / 10, 0.2, change,
        lambda gain: {"source": source + 1, "gain": sign * gain},
    )  # fmt: skip


def torque_drift(at: Place) -> Draft:
    kind = str(at.random.choice(["warm_up", "walk"]))
    scale = at.random.uniform(15, 40) if kind == "warm_up" else at.random.uniform(5, 15)
    seed = int(at.random.integers(2**31))

    def change(w: World, amplitude: float) -> World:
        course = Course(at.j, kind, amplitude, scale, seed)
        return replace(w, sensing=replace(w.sensing, courses=(*w.sensing.courses, course)))

    return Draft(
        "torque_drift",
        (at.j + 1,),
        2 * at.floor,
        5.0,
        change,
        law=kind,
        predictable=kind != "walk",
    )


def time_delay(at: Place) -> Draft:
    name = str(at.random.choice(["delay", "lag"]))
    order = int(at.random.choice([1, 2]))

    def change(w: World, seconds: float) -> World:
        sensing = replace(w.sensing.at(name, at.j, seconds), lag_order=order)
        return replace(w, sensing=sensing)

    return Draft(
        "time_delay", (at.j + 1,), at.floor / 10, 0.06, change,
        lambda t: {name: t} if (name, order) != ("lag", 2) else {}, law=name,
    )  # fmt: skip


def external_contact(at: Place) -> Draft:
    pushes = []
    for recording in range(5):
        drawn = []
        for _ in range(int(at.random.integers(1, 4)) if recording < 2 else 0):
            force = at.random.normal(size=3)
            force /= np.linalg.norm(force)
            wrench = np.array([*force, *0.1 * at.random.normal(size=3)])
            drawn.append((at.random.uniform(5, 55), at.random.uniform(0.3, 1.5), wrench))
        pushes.append(drawn)

    def change(w: World, force: float) -> World:
        made = tuple(tuple(Push(a, b, force * f) for a, b, f in drawn) for drawn in pushes)
        return replace(w, pushes=made)

    return Draft(
        "external_contact", tuple(range(1, N + 1)), 20 * at.floor, 150.0, change,
        lambda _f: {"windows": [[[a, a + b] for a, b, _ in drawn] for drawn in pushes[:2]]},
        predictable=False,
    )  # fmt: skip


def spring_load(at: Place) -> Draft:
    rest, width = at.random.uniform(-0.8, 0.8), at.random.choice([1e3, at.random.uniform(1.0, 3.0)])

    def parameters(rate: float) -> dict:
        return {"stiffness": rate, "rest": rest} if width > 100 else {}

    return Draft(
        "spring_load", (at.j + 1,), 2 * at.floor, 10.0,
        lambda w, rate: w.with_drive(at.j, spring=rate, spring_rest=rest, spring_width=width),
        parameters,
    )  # fmt: skip


def joint_coupling(at: Place) -> Draft:
    a, b = _WRISTS[at.random.integers(3)]
    ratio = float(at.random.choice([-1.0, 1.0]))
    share = at.random.dirichlet([2.0, 2.0, 0.5])

    def change(w: World, amplitude: float) -> World:
        for j, k in ((a, b), (b, a)):
            # the torque on b is ratio times that on a, which is the same law seen from b
            w = w.with_drive(
                j, other=k, ratio=ratio, coupled_viscous=2 * amplitude * share[0],
                coupled_coulomb=amplitude * share[1],
                coupled_inertia=0.3 * amplitude * share[2],
            )  # fmt: skip
        return w

    return Draft("joint_coupling", (a + 1, b + 1), 2 * at.floor, 3.0, change)


def loose_drive(at: Place) -> Draft:
    """Play on the far side of which the drive stays until a flank takes it along."""
    share = float(at.random.uniform(0.6, 1.0))
    return Draft(
        "backlash", (at.j + 1,), at.floor / 20, 0.06,
        lambda w, gap: w.with_drive(at.j, slack=gap, slack_share=share),
        lambda gap: {"gap": gap}, law="loose_drive",
    )  # fmt: skip


KNOWN: dict[str, Callable] = {
    f.__name__: f
    for f in (
        link_inertia, payload, gravity_direction, armature, coulomb_friction, asymmetric_friction,
        viscous_friction, stribeck_friction, presliding_hysteresis, load_dependent_friction,
        position_dependent_friction, temperature_dependent_friction, quadratic_drag, backlash,
        joint_elasticity, torque_ripple, torque_offset, torque_gain, torque_crosstalk,
        torque_drift, encoder_offset, time_delay, external_contact, spring_load, joint_coupling,
    )
}  # fmt: skip
LATER: dict[str, Callable] = {f.__name__: f for f in (loose_drive,)}  # of no seed's turn
