"""Effects of the catalogue, each with the plant's own equation.

A function draws everything about an effect but its amplitude. `j` counts from 0, `floor` is the
noise floor of that joint [N m].
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import drive as drive_
import presliding
from acquisition import Course
from arm import N, add_body
from draft import Draft
from world import Push, World

_WRISTS = ((4, 5), (5, 6), (4, 6))


def link_inertia(random, j, floor, world):
    link = max(j, 1)
    direction = random.normal(size=3)
    com = world.arm.com[link] + 0.05 * direction / np.linalg.norm(direction)

    def change(w: World, mass: float) -> World:
        inertia = mass * 0.03**2 * np.eye(3)
        return replace(w, arm=add_body(w.arm, link, mass, com, inertia))

    same = ("payload",) if link == N - 1 else ()
    return Draft("link_inertia", (link + 1,), 0.05 + 30 * floor, 4.0, change, equivalent=same)


def payload(random, _j, floor, world):
    com = np.array([*random.uniform(-0.03, 0.03, 2), random.uniform(0.06, 0.15)])

    def change(w: World, mass: float) -> World:
        inertia = mass * np.diag(random_box)
        return replace(w, arm=add_body(w.arm, N - 1, mass, com, inertia))

    random_box = random.uniform(0.02, 0.06, 3) ** 2 * 2 / 3
    return Draft(
        "payload", (N,), 10 * floor, 12.0, change,
        lambda mass: {"mass": mass, "com": com.tolist()}, equivalent=("link_inertia",),
    )  # fmt: skip


def gravity_direction(random, _j, floor, world):
    heading = random.uniform(0, 2 * np.pi)

    def gravity(tilt: float) -> np.ndarray:
        side = np.sin(tilt) * np.array([np.cos(heading), np.sin(heading)])
        return -9.81 * np.array([*side, np.cos(tilt)])

    return Draft(
        "gravity_direction", tuple(range(1, N + 1)), floor / 10, 0.3,
        lambda w, tilt: replace(w, arm=w.arm._replace(gravity=gravity(tilt))),
        lambda tilt: {"gravity": gravity(tilt).tolist()},
    )  # fmt: skip


def armature(random, j, floor, world):
    return Draft(
        "armature", (j + 1,), 4 * floor, 3.0,
        lambda w, inertia: w.with_drive(j, armature=inertia),
        lambda inertia: {"inertia": inertia},
    )  # fmt: skip


def coulomb_friction(random, j, floor, world):
    def change(w: World, tau_c: float) -> World:
        coulomb = w.nominal.coulomb.copy()
        coulomb[j] = 0.0
        return w.with_drive(j, coulomb=tau_c).with_nominal(coulomb=coulomb)

    return Draft(
        "coulomb_friction", (j + 1,), 1.1 * floor, 6.0, change, lambda tau_c: {"tau_c": tau_c},
    )  # fmt: skip


def viscous_friction(random, j, floor, world):
    def change(w: World, f_v: float) -> World:
        viscous = w.nominal.viscous.copy()
        viscous[j] = 0.0
        return w.with_drive(j, viscous=f_v).with_nominal(viscous=viscous)

    return Draft(
        "viscous_friction", (j + 1,), 5 * floor, 12.0, change, lambda f_v: {"f_v": f_v},
    )  # fmt: skip


def asymmetric_friction(random, j, floor, world):
    side = random.choice([-1.0, 1.0])
    return Draft(
        "asymmetric_friction", (j + 1,), 2 * floor, 4.0,
        lambda w, excess: w.with_drive(j, one_sided=excess, side=side),
        equivalent=("torque_offset",),
    )  # fmt: skip


def stribeck_friction(random, j, floor, world):
    law = int(random.integers(3))
    speed = np.exp(random.uniform(np.log(0.01), np.log(0.06)))
    delta = {drive_.GAUSS: 2.0, drive_.TUSTIN: 1.0}.get(law)

    def parameters(tau_s: float) -> dict:
        return {} if delta is None else {"tau_s": tau_s, "v_s": speed, "delta": delta}

    return Draft(
        "stribeck_friction", (j + 1,), 2 * floor, 4.0,
        lambda w, tau_s: w.with_drive(j, stribeck=tau_s, stribeck_speed=speed, stribeck_law=law),
        parameters, law=("gauss", "tustin", "lorentz")[law],
    )  # fmt: skip


def presliding_hysteresis(random, j, floor, world):
    law = str(random.choice(list(presliding.LAWS)))
    width = np.exp(random.uniform(np.log(2e-3), np.log(2e-2)))
    fields = presliding.draw(law, 1.0, width, random)
    converts = bool(random.random() < 0.6)  # friction known in height, but not how it builds up

    def change(w: World, sliding: float) -> World:
        coulomb = w.nominal.coulomb.copy()
        coulomb[j] += sliding * converts
        made = w.with_drive(j, **(fields | {"sliding": sliding}))
        return made.with_nominal(coulomb=coulomb)

    return Draft("presliding_hysteresis", (j + 1,), 2 * floor, 4.0, change, law=law)


def load_dependent_friction(random, j, floor, world):
    side = float(random.choice([0.0, 0.0, 1.0, -1.0]))
    variant = {0.0: "absolute", 1.0: "positive", -1.0: "negative"}[side]
    return Draft(
        "load_dependent_friction", (j + 1,), floor / 4, 0.4,
        lambda w, k: w.with_drive(j, load=k, load_side=side),
        lambda k: {"coefficient": k}, law=variant,
    )  # fmt: skip


def position_dependent_friction(random, j, floor, world):
    if random.random() < 0.5:
        place, width = random.uniform(-0.8, 0.8), random.uniform(0.2, 0.6)
        return Draft(
            "position_dependent_friction", (j + 1,), 2 * floor, 4.0,
            lambda w, a: w.with_drive(j, bump=(a, place, width)), law="bump",
        )  # fmt: skip
    share, cycles = random.dirichlet(np.ones(3)), np.array([1.0, 2.0, 3.0])
    phase = random.uniform(0, 2 * np.pi, 3)

    def change(w: World, amplitude: float) -> World:
        return w.with_drive(j, where=np.stack([amplitude * share, cycles, phase], axis=1))

    return Draft(
        "position_dependent_friction", (j + 1,), 2 * floor, 0.6 * float(world.drive["coulomb"][j]),
        change, law="fourier",
    )  # fmt: skip


def temperature_dependent_friction(random, j, floor, world):
    time = random.uniform(15.0, 45.0)
    return Draft(
        "temperature_dependent_friction", (j + 1,), 3 * floor, 4.0,
        lambda w, excess: w.with_drive(j, cold=excess, warming=time),
    )  # fmt: skip


def quadratic_drag(random, j, floor, world):
    power = random.uniform(1.85, 2.15)
    return Draft(
        "quadratic_drag", (j + 1,), 30 * floor, 30.0,
        lambda w, c: w.with_drive(j, drag=c, power=power),
    )  # fmt: skip


def backlash(random, j, floor, world):
    stiffness = 4e5 if j < 4 else 1e5
    return Draft(
        "backlash", (j + 1,), floor / 20, 0.03,
        lambda w, gap: w.with_drive(j, stiffness=stiffness, gap=gap),
        lambda gap: {"gap": gap},
    )  # fmt: skip


def joint_elasticity(random, j, floor, world):
    hardening = float(random.choice([0.0, random.uniform(0, 3e3)]))

    def change(w: World, compliance: float) -> World:
        return w.with_drive(j, stiffness=1 / compliance, hardening=hardening)

    def parameters(compliance: float) -> dict:
        return {} if hardening else {"stiffness": 1 / compliance}

    return Draft("joint_elasticity", (j + 1,), 2e-4 * floor, 1e-3, change, parameters)


def torque_ripple(random, j, floor, world):
    cycles = float(np.round(np.exp(random.uniform(np.log(8), np.log(100)))))
    second = random.choice([0.0, random.uniform(0.2, 0.5)])
    phase = random.uniform(0, 2 * np.pi, 2)

    def change(w: World, amplitude: float) -> World:
        rows = [(amplitude, cycles, phase[0]), (second * amplitude, 2 * cycles, phase[1])]
        return w.with_drive(j, ripple=np.array([*rows, (0.0, 1.0, 0.0)]))

    return Draft(
        "torque_ripple", (j + 1,), 1.5 * floor, 3.0, change,
        lambda a: {"cycles_per_rev": [cycles], "amplitude": [a]},
    )  # fmt: skip


def torque_offset(random, j, floor, world):
    sign = random.choice([-1.0, 1.0])
    return _sensed(
        "torque_offset", j, 1.0 * floor, 5.0, "offset", sign, equivalent=("asymmetric_friction",)
    )


def torque_gain(random, j, floor, world):
    return _sensed("torque_gain", j, floor / 3, 0.4, "gain", random.choice([-1.0, 1.0]))


def encoder_offset(random, j, floor, world):
    sign = random.choice([-1.0, 1.0])
    return _sensed("encoder_offset", j, floor / 30, 0.1, "encoder_offset", sign)


def _sensed(effect, j, guess, largest, name, sign, **more):
    key = "gain" if name == "gain" else "offset"
    return Draft(
        effect, (j + 1,), guess, largest,
        lambda w, x: replace(w, sensing=w.sensing.at(name, j, sign * x)),
        lambda x: {key: sign * x}, **more,
    )  # fmt: skip


def torque_crosstalk(random, j, floor, world):
    source = int(random.choice([k for k in (0, 1, 2, 3) if k != j]))
    sign = random.choice([-1.0, 1.0])

    def change(w: World, gain: float) -> World:
        matrix = w.sensing.crosstalk.copy()
        matrix[j, source] += sign * gain
        return replace(w, sensing=replace(w.sensing, crosstalk=matrix))

    return Draft(
        "torque_crosstalk", (j + 1,), floor / 10, 0.2, change,
        lambda gain: {"source": source + 1, "gain": sign * gain},
    )  # fmt: skip


def torque_drift(random, j, floor, world):
    kind = str(random.choice(["warm_up", "walk"]))
    scale = random.uniform(15, 40) if kind == "warm_up" else random.uniform(5, 15)
    seed = int(random.integers(2**31))

    def change(w: World, amplitude: float) -> World:
        course = Course(j, kind, amplitude, scale, seed)
        return replace(w, sensing=replace(w.sensing, courses=(*w.sensing.courses, course)))

    return Draft(
        "torque_drift", (j + 1,), 2 * floor, 5.0, change, law=kind, foretellable=kind != "walk"
    )


def time_delay(random, j, floor, world):
    name = str(random.choice(["delay", "lag"]))
    order = int(random.choice([1, 2]))

    def change(w: World, seconds: float) -> World:
        sensing = replace(w.sensing.at(name, j, seconds), lag_order=order)
        return replace(w, sensing=sensing)

    return Draft(
        "time_delay", (j + 1,), floor / 10, 0.06, change,
        lambda t: {name: t} if (name, order) != ("lag", 2) else {}, law=name,
    )  # fmt: skip


def external_contact(random, _j, floor, world):
    pushes = []
    for recording in range(4):
        drawn = []
        for _ in range(int(random.integers(1, 4)) if recording < 2 else 0):
            force = random.normal(size=3)
            force /= np.linalg.norm(force)
            wrench = np.array([*force, *0.1 * random.normal(size=3)])
            drawn.append((random.uniform(5, 55), random.uniform(0.3, 1.5), wrench))
        pushes.append(drawn)

    def change(w: World, force: float) -> World:
        made = tuple(tuple(Push(a, b, force * f) for a, b, f in drawn) for drawn in pushes)
        return replace(w, pushes=made)

    return Draft(
        "external_contact", tuple(range(1, N + 1)), 20 * floor, 150.0, change,
        lambda _f: {"windows": [[[a, a + b] for a, b, _ in drawn] for drawn in pushes[:2]]},
        foretellable=False,
    )  # fmt: skip


def spring_load(random, j, floor, world):
    rest, width = random.uniform(-0.8, 0.8), random.choice([1e3, random.uniform(1.0, 3.0)])

    def parameters(rate: float) -> dict:
        return {"stiffness": rate, "rest": rest} if width > 100 else {}

    return Draft(
        "spring_load", (j + 1,), 2 * floor, 10.0,
        lambda w, rate: w.with_drive(j, spring=rate, spring_rest=rest, spring_width=width),
        parameters,
    )  # fmt: skip


def joint_coupling(random, _j, floor, world):
    a, b = _WRISTS[random.integers(3)]
    ratio = float(random.choice([-1.0, 1.0]))
    share = random.dirichlet([2.0, 2.0, 0.5])

    def change(w: World, amplitude: float) -> World:
        for j, k in ((a, b), (b, a)):
            # the torque on b is ratio times that on a, which is the same law seen from b
            w = w.with_drive(
                j, other=k, ratio=ratio, coupled_viscous=2 * amplitude * share[0],
                coupled_coulomb=amplitude * share[1],
                coupled_inertia=0.3 * amplitude * share[2],
            )  # fmt: skip
        return w

    return Draft("joint_coupling", (a + 1, b + 1), 2 * floor, 3.0, change)


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
