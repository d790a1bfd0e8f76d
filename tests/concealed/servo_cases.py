"""Concealed cases without torque: an arm behind servos that has something in it that nobody stated.

A case is three recordings of commands and positions and the simulation that is believed of the arm,
all drawn from one integer seed. What is hidden is kept apart.
"""

from dataclasses import dataclass
from pathlib import Path

import arm as arm_
import numpy as np
import servo_plant as plant
import yaml
from servo_plant import LINK, MOTOR, N, Played

from limo_driver.recordings.recording import Recording

TOLERANCE = 0.1  # of what is stated of the drives, relative
_DRAWS, _BEYOND = 20, 0.4  # [rad], which a zero may add to the range
SECONDS = 24.0  # of each recording
GAIN, BRAKE, STALL, ROTOR, DRY, WET, LATE = 17.0, 0.8, 2.9, 0.028, 0.12, 0.08, 0.015
LOADED = (1, 2)  # joints that gravity loads well, 0-based
SINGLES = (
    "payload",
    "backlash",
    "encoder_offset",
    "joint_sign",
    "drive_delay",
    "coulomb_friction",
    "position_servo",
    "dead_band",
    "spring_load",
    "load_dependent_friction",
)


OTHERS = (
    "gear_ratio",
    "swapped_joints",
    "supply_sag",
    "integral_gain",
    "stribeck_friction",
)
LIMITS = (  # what came last: of servos at their limits
    "punch",
    "thermal_derating",
    "torque_limit",
    "voltage_limit",
    "profile_speed",
    "profile_acceleration",
    "motor_friction",
    "damped_torque_limit",
)
NAMED = {  # as which effect a diagnosis names them
    "motor_friction": "load_dependent_friction",
    "damped_torque_limit": "torque_limit",
}
WHOLE = ("payload", "supply_sag")  # what no single joint has
COUNTED = ("joint_sign", "swapped_joints")  # how recordings count


@dataclass(frozen=True)
class Hidden:
    """One thing that nobody stated."""

    effect: str  # as a diagnosis names it
    joints: tuple[int, ...]  # 1-based; none for the whole arm
    size: float  # in the unit of the effect


@dataclass(frozen=True)
class Case:
    """Recordings, what is believed, and what is hidden."""

    seed: int
    hidden: tuple[Hidden, ...]
    recordings: tuple[Played, ...]
    stated: dict  # sim.yaml
    description: str  # MJCF
    servos: np.ndarray  # (n,) as they are, with the fields of `servo_plant.FIELDS`
    channels: tuple[str, ...] = ()  # of the commands of each joint

    def write(self, folder: Path) -> tuple[Path, list[Path]]:
        """Write what a diagnosis is given; return the paths of simulation and recordings."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "hobby.xml").write_text(self.description)
        (folder / "sim.yaml").write_text(yaml.safe_dump(self.stated))
        paths = [folder / f"moves{k}.parquet" for k in range(len(self.recordings))]
        for path, own in zip(paths, self.recordings, strict=True):
            told = {"command": own.command, "channels": self.channels}
            Recording.from_arrays(own.time, own.position, **told).save(path)
        return folder / "sim.yaml", paths


def drawn_set(seed: int) -> tuple[str, ...]:
    """Draw two or three effects: at most one of each loaded joint, and one of how joints count."""
    random = np.random.default_rng([seed, 11])
    many, chosen = int(random.integers(2, 4)), list[str]()
    every = (*SINGLES, *OTHERS)
    for k in random.permutation(len(every)).tolist():
        own = [*chosen, every[k]]
        single = [x for x in own if x not in (*WHOLE, "swapped_joints")]
        if len(single) <= len(LOADED) and sum(x in COUNTED for x in own) < 2:
            chosen = own
        if len(chosen) == many:
            break
    return tuple(chosen)


def make(
    seed: int,
    effects: tuple[str, ...],
    rate: float = 200.0,
    bits: int = 12,
    commanded: tuple[float, np.ndarray] | None = None,
) -> Case:
    """Draw a case; once more if its arm leaves the ranges of its joints, as no real one can.

    Args:
        seed: Of all that is drawn.
        effects: What is hidden, of `SINGLES`, `OTHERS` and `LIMITS`; those of single joints at
            joints of their own.
        rate: Of the recordings [Hz].
        bits: Of the encoders.
        commanded: Seconds between two commands, and commands (K, n) [rad], of one recording that
            stands in for the usual three.
    """
    for attempt in range(_DRAWS):
        case = _drawn(seed, attempt, effects, rate, bits, commanded)
        if max(np.abs(own.position).max() for own in case.recordings) < plant.REACH + _BEYOND:
            return case
    raise ValueError(f"{effects} lead the arm beyond its joints in every one of {_DRAWS} draws")


def _drawn(
    seed: int,
    attempt: int,
    effects: tuple[str, ...],
    rate: float,
    bits: int,
    commanded: tuple[float, np.ndarray] | None,
) -> Case:
    random = np.random.default_rng([seed, 7, attempt] if attempt else [seed, 7])
    arm = plant.hobby_arm()
    believed = _servos(random, bits)
    servos = believed.copy()
    for name in ("gain", "brake", "rotor", "dry", "wet", "late"):
        servos[name] *= np.exp(TOLERANCE * np.clip(random.normal(size=N), -2, 2))
    stall = np.random.default_rng([seed, 13]).normal(size=N)
    servos["stall"] *= np.exp(TOLERANCE * np.clip(stall, -2, 2))
    true, sign, zero, order = arm, np.ones(N), np.zeros(N), list(range(N))
    hidden, free = list[Hidden](), list(LOADED)
    for effect in effects:
        size, joints = 0.0, ()
        if effect == "payload":
            size = float(random.uniform(0.08, 0.25))
            true = arm_.add_body(
                arm, N - 1, size, np.array([plant.HAND + 0.02, 0, 0]), np.eye(3) * 2e-5
            )
        elif effect == "supply_sag":
            size = float(random.uniform(0.25, 0.6))
            servos["source"] = size
        elif effect == "swapped_joints":
            joints = tuple(sorted(int(j) for j in random.choice(N, 2, replace=False)))
            order[joints[0]], order[joints[1]] = order[joints[1]], order[joints[0]]
        else:
            joint = int(random.choice(free))
            free.remove(joint)
            joints, size = (joint,), _SIZES[effect](random)
            _hide(servos, effect, joint, size, random)
            sign[joint] = -1.0 if effect == "joint_sign" else 1.0
            zero[joint] = size if effect == "encoder_offset" else 0.0
        hidden.append(Hidden(NAMED.get(effect, effect), tuple(j + 1 for j in joints), size))
    tick = servos["tick"][0]
    recordings = []
    every = max(1 / rate, 0.005)
    motions = [(every, _command(kind, every, random)) for kind in ("waves", "ramps", "steps")]
    for every, command in [commanded] if commanded else motions:
        own = plant.play(true, servos, command, every, rate)
        position = tick * np.round((own.position * sign + zero) / tick)
        told = (own.command * sign + zero)[:, order]
        recordings.append(Played(own.time, told, position[:, order]))
    stated, description = _stated(believed), plant.mjcf(arm)
    return Case(seed, tuple(hidden), tuple(recordings), stated, description, servos)


_SIZES = {
    "backlash": lambda r: float(r.uniform(0.02, 0.05)),  # [rad]
    "encoder_offset": lambda r: float(r.choice([-1, 1]) * r.uniform(0.12, 0.3)),  # [rad]
    "joint_sign": lambda _r: -1.0,
    "drive_delay": lambda r: float(LATE + r.uniform(0.03, 0.06)),  # [s]
    "coulomb_friction": lambda r: float(DRY * r.uniform(2.2, 4.0)),  # [N m]
    "position_servo": lambda r: float(GAIN * r.uniform(0.4, 0.6)),  # [N m/rad]
    "dead_band": lambda r: float(r.uniform(0.015, 0.04)),  # [rad]
    "spring_load": lambda r: float(r.uniform(0.25, 0.6)),  # [N m/rad]
    "load_dependent_friction": lambda r: float(r.uniform(0.25, 0.5)),
    "gear_ratio": lambda r: float(r.choice([0.43, 0.55, 1.8, 2.3])),  # of gears that are sold
    "integral_gain": lambda r: float(r.uniform(5.0, 25.0)),  # [N m/(rad s)]
    "stribeck_friction": lambda r: float(DRY * r.uniform(1.0, 2.5)),  # [N m]
    "punch": lambda r: float(DRY * r.uniform(0.5, 0.9)),  # [N m]
    "thermal_derating": lambda r: float(r.uniform(0.8, 2.0)),
    "torque_limit": lambda r: float(STALL * r.uniform(0.3, 0.5)),  # [N m]
    "voltage_limit": lambda r: float(r.uniform(0.8, 1.4)),  # [rad/s]
    "profile_speed": lambda r: float(r.uniform(0.5, 1.0)),  # [rad/s]
    "profile_acceleration": lambda r: float(r.uniform(1.5, 4.0)),  # [rad/s^2]
    "motor_friction": lambda r: float(r.uniform(0.25, 0.4)),
    "damped_torque_limit": lambda r: float(STALL * r.uniform(0.3, 0.5)),  # [N m]
}
_FIELD_OF = {
    "drive_delay": "late",
    "coulomb_friction": "dry",
    "position_servo": "gain",
    "dead_band": "band",
    "spring_load": "hose",
    "load_dependent_friction": "by_load",
    "backlash": "gap",
    "integral_gain": "reset",
    "stribeck_friction": "breakaway",
    "punch": "kick",
    "thermal_derating": "fade",
    "torque_limit": "stall",
    "voltage_limit": "pace",
    "profile_speed": "slew",
    "profile_acceleration": "ramp",
    "motor_friction": "by_drive",
    "damped_torque_limit": "stall",
}
_GEARED = {"gain": 1, "stall": 1, "dry": 1, "brake": 2, "rotor": 2, "wet": 2}  # powers of the ratio


def _hide(
    servos: np.ndarray, hidden: str, joint: int, size: float, random: np.random.Generator
) -> None:
    if hidden in _FIELD_OF:
        servos[_FIELD_OF[hidden]][joint] = size
    if hidden == "gear_ratio":
        for name, power in _GEARED.items():
            servos[name][joint] *= size**power
    if hidden == "spring_load":
        servos["hose_rest"][joint] = random.uniform(-0.5, 0.5)
    if hidden == "thermal_derating":
        servos["warm"][joint] = random.uniform(5.0, 15.0)
    if hidden == "damped_torque_limit":  # servos that limit what their derivative asks for, too
        servos["rate"], servos["brake"] = servos["brake"].copy(), 0.0
    if hidden == "backlash":
        servos["looks_at"][joint] = MOTOR


def _servos(random: np.random.Generator, bits: int, n: int = N) -> np.ndarray:
    """Return n servos of one kind, whose friction differs."""
    servos = np.zeros(n, plant.FIELDS)
    kind = np.exp(0.15 * random.normal())
    servos["gain"], servos["brake"], servos["stall"] = GAIN * kind, BRAKE * kind, STALL
    servos["rotor"] = ROTOR
    servos["dry"] = DRY * np.exp(0.15 * random.normal(size=n))
    servos["breakaway"] = 0.05 * DRY
    servos["wet"], servos["late"] = WET, LATE * random.uniform(0.7, 1.5)
    servos["tick"] = 2 * np.pi / 2**bits
    servos["looks_at"] = servos["tells"] = LINK
    return servos


def _stated(believed: np.ndarray) -> dict:
    """Return the simulation that is believed of the arm."""
    drives, effects = [], []
    for j, own in enumerate(believed, start=1):
        drives.append(
            {"drive": "position_servo", "joint": j, "kp": float(own["gain"]),
             "kd": float(own["brake"]), "torque_limit": float(own["stall"]),
             "delay": float(own["late"])}
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


def _command(kind: str, every: float, random: np.random.Generator) -> np.ndarray:
    """Return commands, (K, n) [rad]."""
    time = np.arange(0.0, SECONDS, every)
    command = np.zeros((time.size, N))
    for j in range(N):
        if kind == "waves":
            for _ in range(4):
                pace = np.exp(random.uniform(np.log(0.3), np.log(5.0)))
                height = min(0.7, 1.6 / pace) * random.uniform(0.5, 1.0)
                command[:, j] += 0.5 * height * np.sin(pace * time + random.uniform(0, 2 * np.pi))
        else:
            length = (1.5, 4.0) if kind == "ramps" else (0.8, 2.0)
            at = [0.0]
            while at[-1] < SECONDS:
                at.append(at[-1] + random.uniform(*length))
            goals = random.uniform(-1.1, 1.1, len(at))
            if kind == "ramps":
                goals[2::3] = goals[1::3][: goals[2::3].size]  # holds
                command[:, j] = np.interp(time, at, goals)
            else:
                goals = np.cumsum(np.clip(np.diff(goals, prepend=0.0), -0.5, 0.5))
                goals = np.clip(goals, -1.2, 1.2)
                command[:, j] = goals[np.searchsorted(at, time, side="right") - 1]
    centre = np.array([0.0, 0.9, -0.6, -0.3]) if kind == "waves" else np.array([0, 0.9, 0, 0])
    return np.clip(command + centre, -1.9, 1.9)
