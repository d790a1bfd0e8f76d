"""Concealed cases of an arm that is told velocities or torques, drawn as those of `servo_cases`."""

from dataclasses import dataclass, field
from types import ModuleType

import arm as arm_
import numpy as np
import pushing_plant
import servo_plant
import turning_plant
from servo_cases import DRY, LATE, LOADED, ROTOR, STALL, TOLERANCE, WET, Case, Hidden, _command
from servo_plant import N, Played

_SIZES = {
    "encoder_offset": lambda r: float(r.choice([-1, 1]) * r.uniform(0.12, 0.3)),  # [rad]
    "drive_delay": lambda r: float(LATE + r.uniform(0.03, 0.06)),  # [s]
    "coulomb_friction": lambda r: float(DRY * r.uniform(2.2, 4.0)),  # [N m]
    "velocity_servo": lambda r: float(3.0 * r.uniform(0.4, 0.6)),  # [N m s/rad]
    "torque_drive": lambda r: float(r.choice([r.uniform(0.55, 0.7), r.uniform(1.4, 1.8)])),
    "integral_gain": lambda r: float(r.uniform(5.0, 25.0)),  # [N m/rad]
    "spring_load": lambda r: float(r.uniform(0.25, 0.6)),  # [N m/rad]
    "load_dependent_friction": lambda r: float(r.uniform(0.25, 0.5)),
}
_FIELD_OF = {
    "drive_delay": "late",
    "coulomb_friction": "dry",
    "velocity_servo": "gain",
    "torque_drive": "gain",
    "integral_gain": "reset",
    "spring_load": "hose",
    "load_dependent_friction": "by_load",
}


@dataclass(frozen=True)
class Told:
    """An arm whose drives are told what is no position."""

    plant: ModuleType
    drive: str  # as limo names it
    parameter: str  # its gain there
    gain: float
    channel: str
    singles: tuple[str, ...]
    sizes: dict = field(default_factory=dict)  # of what is hidden, other than usual

    def make(
        self, seed: int, effects: tuple[str, ...], rate: float = 200.0, bits: int = 12
    ) -> Case:
        """Draw a case.

        Args:
            seed: Of all that is drawn.
            effects: What is hidden, one of `singles`, or nothing.
            rate: Of the recordings [Hz].
            bits: Of the encoders.
        """
        return _made(self, seed, effects, rate, bits)


TURNING = Told(
    turning_plant,
    "velocity_servo",
    "kv",
    3.0,
    "command_velocity",
    (
        "payload",
        "velocity_servo",
        "drive_delay",
        "coulomb_friction",
        "integral_gain",
        "spring_load",
        "encoder_offset",
        "load_dependent_friction",
    ),
)
PUSHING = Told(
    pushing_plant,
    "torque_drive",
    "gain",
    1.0,
    "command_torque",
    (
        "payload",
        "torque_drive",
        "drive_delay",
        "coulomb_friction",
        "spring_load",
        "encoder_offset",
        "load_dependent_friction",
    ),
    {"drive_delay": lambda r: float(LATE + r.uniform(0.02, 0.04))},  # a program waits no longer
)


def _made(told: Told, seed: int, effects: tuple[str, ...], rate: float, bits: int) -> Case:
    random = np.random.default_rng([seed, 17])
    arm = true = servo_plant.hobby_arm()
    believed = np.zeros(N, told.plant.FIELDS)
    believed["gain"] = told.gain * np.exp(0.15 * random.normal())
    believed["stall"], believed["rotor"], believed["wet"] = STALL, ROTOR, WET
    believed["dry"] = DRY * np.exp(0.15 * random.normal(size=N))
    believed["late"] = LATE * random.uniform(0.7, 1.5)
    believed["tick"] = 2 * np.pi / 2**bits
    servos, zero, hidden = believed.copy(), np.zeros(N), list[Hidden]()
    for name in ("gain", "stall", "rotor", "dry", "wet", "late"):
        servos[name] *= np.exp(TOLERANCE * np.clip(random.normal(size=N), -2, 2))
    for effect in effects:
        joints: tuple[int, ...] = ()
        if effect == "payload":
            size = float(random.uniform(0.08, 0.25))
            at = np.array([servo_plant.HAND + 0.02, 0, 0])
            true = arm_.add_body(arm, N - 1, size, at, np.eye(3) * 2e-5)
        else:
            joint, size = int(random.choice(LOADED)), (_SIZES | told.sizes)[effect](random)
            joints = (joint + 1,)
            if effect in _FIELD_OF:
                servos[_FIELD_OF[effect]][joint] = size
            if effect == "spring_load":
                servos["hose_rest"][joint] = random.uniform(-0.5, 0.5)
            zero[joint] = size if effect == "encoder_offset" else 0.0
        hidden.append(Hidden(effect, joints, size))
    tick, recordings = believed["tick"][0], list[Played]()
    for kind in ("waves", "ramps", "waves"):
        every = max(1 / rate, 0.005)
        path = _smooth(_command(kind, every, random), every)
        own = told.plant.play(true, servos, path, every, rate)
        position = tick * np.round((own.position + zero) / tick)
        recordings.append(Played(own.time, own.command, position))
    return Case(
        seed,
        tuple(hidden),
        tuple(recordings),
        _stated(told, believed),
        servo_plant.mjcf(arm),
        servos,
        (told.channel,) * N,
    )


def _smooth(path: np.ndarray, every: float) -> np.ndarray:
    """Return a path without corners, whose velocity a program can send."""
    width = round(0.1 / every)
    padded = np.pad(path, ((width, width), (0, 0)), mode="edge")
    mean = np.ones(2 * width + 1) / (2 * width + 1)
    return np.stack([np.convolve(own, mean, "valid") for own in padded.T], axis=1)


def _stated(told: Told, believed: np.ndarray) -> dict:
    """Return the simulation that is believed of the arm."""
    drives, effects = [], []
    for j, own in enumerate(believed, start=1):
        drives.append(
            {"drive": told.drive, "joint": j, told.parameter: float(own["gain"]),
             "torque_limit": float(own["stall"]), "delay": float(own["late"])}
        )  # fmt: skip
        effects += [
            {"effect": "coulomb_friction", "joint": j, "tau_c": float(own["dry"])},
            {"effect": "viscous_friction", "joint": j, "f_v": float(own["wet"])},
            {"effect": "armature", "joint": j, "inertia": float(own["rotor"])},
        ]
    return {
        "robot": "hobby.xml",
        "tolerances": {"drive": TOLERANCE},
        "drives": drives,
        "effects": effects,
    }
