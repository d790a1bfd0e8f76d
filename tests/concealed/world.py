"""A concealed world: the true plant, and the nominal model of it that is handed to a diagnosis."""

from dataclasses import dataclass, field, replace

import arm as arm_
import drive as drive_
import numpy as np
from acquisition import Sensing
from arm import Arm, N
from plant import PERIOD, Control, Reference, Response, simulate

COULOMB = np.array([2.2, 2.4, 1.6, 1.7, 0.9, 0.45, 0.35])  # [N m]
VISCOUS = np.array([4.0, 4.2, 2.4, 2.6, 1.1, 0.55, 0.4])  # [N m s/rad]
ROTOR = np.array([2.0, 2.0, 1.0, 1.0, 0.5, 0.3, 0.3])  # [kg m^2] seen from the joint
_LINKS = np.array([2.0, 2.0, 0.6, 0.5, 0.1, 0.05, 0.01])  # [kg m^2], about what a drive moves
INERTIA, FRICTION = 0.02, 0.15  # tolerances of the nominal model
_SIGMAS = 2.5  # beyond which no tolerance goes


@dataclass(frozen=True)
class Push:
    """Somebody pushes at the flange for a moment: half a sine."""

    start: float  # [s]
    length: float  # [s]
    wrench: np.ndarray  # (6,) [N, N m] in world axes, at its height


@dataclass(frozen=True)
class Nominal:
    """What the simulation handed over holds, before its tolerances."""

    arm: Arm
    coulomb: np.ndarray  # (n,) [N m]; 0: not in the file
    viscous: np.ndarray  # (n,) [N m s/rad]
    entries: tuple[dict, ...] = ()  # further effects in the file
    wrong: frozenset[tuple[str, int]] = frozenset()  # friction (name, 0-based joint) that is as
    # far off as it stands, so that no tolerance is added to it

    def torque(self, response: Response, sharpness: float) -> np.ndarray:
        """Return what it says about a motion, with the true sharpness of the sign."""
        v = response.velocity
        rigid = arm_.along(self.arm, arm_.work(), response.position, v, response.acceleration)
        return rigid + self.coulomb * v * drive_.slope(v, sharpness) + self.viscous * v


@dataclass(frozen=True)
class World:
    arm: Arm
    drive: np.ndarray
    nominal: Nominal
    sensing: Sensing = field(default_factory=Sensing)
    pushes: tuple[tuple[Push, ...], ...] = ((), (), (), (), ())  # for each recording

    @classmethod
    def draw(cls, random: np.random.Generator) -> "World":
        arm, _ = arm_.load()
        coulomb = COULOMB * random.uniform(0.7, 1.4, N)
        viscous = VISCOUS * random.uniform(0.7, 1.4, N)
        sharpness = random.uniform(0.5e-3, 1.5e-3)
        return cls(
            arm,
            drive_.plain(ROTOR * random.uniform(0.7, 1.4, N), coulomb, viscous, sharpness),
            Nominal(arm, coulomb, viscous),
        )

    def with_drive(self, joint: int, **values: object) -> "World":
        return replace(self, drive=drive_.changed(self.drive, joint, **values))

    def with_nominal(self, **values: object) -> "World":
        return replace(self, nominal=replace(self.nominal, **values))

    def respond(self, motion: np.ndarray, recording: int, random: np.random.Generator) -> Response:
        """Let the plant follow positions given every millisecond, (T, n) [rad]."""
        velocity = np.gradient(motion, PERIOD, axis=0)
        acceleration = np.gradient(velocity, PERIOD, axis=0)
        believed = arm_.along(self.nominal.arm, arm_.work(), motion, velocity, acceleration)
        believed = believed * random.uniform(0.95, 1.05, N)
        believed += self.drive["rotor"] * acceleration + VISCOUS * velocity
        believed += random.uniform(0.5, 0.9) * COULOMB * np.tanh(velocity / 5e-3)
        inertia = (ROTOR + _LINKS) * random.uniform(0.7, 1.3, N)
        bandwidth = random.uniform(20.0, 35.0)  # [rad/s]
        control = Control(
            inertia * bandwidth**2,
            2 * random.uniform(0.6, 0.9) * inertia * bandwidth,
            0.1 * inertia * bandwidth**3,
        )
        reference = Reference(motion, velocity, acceleration, believed)
        return simulate(
            self.arm, self.drive, control, reference, self._wrench(len(motion), recording)
        )

    def _wrench(self, rows: int, recording: int) -> np.ndarray:
        time, wrench = np.arange(rows) * PERIOD, np.zeros((rows, 6))
        for push in self.pushes[recording]:
            phase = (time - push.start) / push.length
            inside = (phase > 0) & (phase < 1)
            wrench[inside] += np.sin(np.pi * phase[inside])[:, None] * push.wrench
        return wrench

    def simulation_file(self, random: np.random.Generator) -> dict:
        """Return the `sim.yaml` handed over: nominal values off inside their tolerances."""
        off = off_within(self.nominal.arm, random)
        inertials = {}
        for i in range(N):
            inertia = off.inertia[i]
            inertials[f"link{i + 1}"] = {
                "mass": float(off.mass[i]),
                "com": [float(x) for x in off.com[i]],
                "inertia": [float(x) for x in inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]],
            }
        effects = []
        for j in range(N):
            tau_c, f_v = (self._stated(name, j, normal(random)) for name in ("coulomb", "viscous"))
            if tau_c:
                dry = {"effect": "coulomb_friction", "joint": j + 1}
                effects.append(dry | {"tau_c": float(tau_c), "v_eps": 0.002})
            if f_v:
                effects.append({"effect": "viscous_friction", "joint": j + 1, "f_v": float(f_v)})
        return {
            "robot": "iiwa14",
            "inertials": inertials,
            "tolerances": {"inertia": INERTIA, "friction": FRICTION},
            "effects": effects + [dict(entry) for entry in self.nominal.entries],
        }

    def _stated(self, name: str, joint: int, sigmas: float) -> float:
        """Return friction as the file states it: the truth is so many sigmas from that value.

        A tolerance is relative to the value stated, which is all that a reader of the file has.
        """
        value = float(getattr(self.nominal, name)[joint])
        return value if (name, joint) in self.nominal.wrong else value / (1 + FRICTION * sigmas)


def off_within(arm: Arm, random: np.random.Generator, off: float = INERTIA) -> Arm:
    """Return an arm whose masses, centres and inertias are off by 2 %, as in a data sheet."""
    mass, com, inertia = arm.mass.copy(), arm.com.copy(), arm.inertia.copy()
    for i in range(N):
        mass[i] *= 1 + off * normal(random)
        com[i] += off * np.linalg.norm(arm.com[i]) * normal(random, 3)
        e = off * normal(random, 3)
        inertia[i] *= 1 + (e[:, None] + e[None, :]) / 2
    return arm._replace(mass=mass, com=com, inertia=inertia)


def normal(random: np.random.Generator, size: int | None = None) -> np.ndarray:
    return np.clip(random.normal(size=size), -_SIGMAS, _SIGMAS)
