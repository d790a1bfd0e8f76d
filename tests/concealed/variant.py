"""Variants of a case: shorter recordings, arms of another strength, and arms of fewer joints.

An arm that is s times as heavy needs s times the torque for the same motion. So a case of another
strength is the same one in another unit of mass: bodies, friction and noise times s. A joint that
is locked is none: the plant gives its rotor the inertia of a house, and what is handed over has one
body for the links on both its sides.
"""

from dataclasses import dataclass, replace
from xml.etree import ElementTree as ET

import motions
import numpy as np
from acquisition import Recorded
from arm import EFFORT, Arm, Limits, N, add_body, load
from plant import PERIOD
from scipy.spatial.transform import Rotation
from world import World

MOVING = {4: (0, 1, 3, 6), 6: (0, 1, 3, 4, 5, 6), N: tuple(range(N))}  # joints, 0-based
ROBOT = "arm.urdf"
_HOUSE = 1e9  # [kg m^2]
_ANY_POSITION = {"encoder_offset"}  # effects whose parameters are no torques
_TORQUES = {"tau_c", "f_v", "tau_s", "offset", "amplitude", "inertia", "mass", "stiffness"}
_OF_TWO = {
    "joint_coupling",
    "torque_crosstalk",
}  # effects of two joints, of which one may be locked
_SEGMENT = 10.0  # [s]


@dataclass(frozen=True)
class Variant:
    """How a case differs from the usual one: two minutes of an arm of 320 N m and seven joints."""

    seconds: float = 0.0  # of each recording to diagnose; 0: as drawn
    full_scale: float = EFFORT[0]  # [N m] that the strongest drive can do
    joints: int = N

    @property
    def usual(self) -> bool:
        """Whether the arm is the usual one, which limo knows by its name."""
        return self.full_scale == EFFORT[0] and self.joints == N

    @property
    def moving(self) -> list[int]:
        """Return the joints that move, 0-based."""
        return list(MOVING[self.joints])

    @property
    def locked(self) -> list[int]:
        return [j for j in range(N) if j not in self.moving]

    @property
    def strength(self) -> float:
        return float(self.full_scale / EFFORT[0])

    def allows(self, effect: str) -> bool:
        """Say whether an effect can be drawn."""
        return effect not in _OF_TWO or not self.locked

    def world(self, world: World) -> World:
        """Lock the joints that do not move."""
        for joint in self.locked:
            world = world.with_drive(joint, rotor=_HOUSE)
        return world

    def plan(
        self, plan: list[tuple[list[str], float]], random: np.random.Generator
    ) -> list[tuple[list[str], float]]:
        """Shorten the recordings to diagnose: fewer segments in each."""
        if not self.seconds:
            return plan
        count = max(1, int(self.seconds / _SEGMENT))
        pairs = ["fourier", "nested", "creep"], ["points", "fourier", "creep"]
        return [(list(random.permutation(kinds)[:count]), self.seconds) for kinds in pairs] + plan[
            2:
        ]

    def motion(self, kinds: list[str], seconds: float, limits: Limits, random: np.random.Generator):
        """Return positions (T, n) [rad] in which locked joints are at zero, and the segments."""
        position, names = motions.recording(kinds, seconds, limits, random)
        if seconds == self.seconds:
            position = position[: int(seconds / PERIOD)]
        position[:, self.locked] = 0.0
        return position, names

    def recorded(self, recorded: Recorded) -> Recorded:
        """Return what the sensors of this arm say: no column of a joint that is locked."""
        rows = {
            name: getattr(recorded, name)[:, self.moving]
            for name in ("position", "torque", "velocity", "heat", "clean")
        }
        strong = {name: self.strength * rows[name] for name in ("torque", "clean")}
        return replace(recorded, **(rows | strong))

    def whole(self, position: np.ndarray) -> np.ndarray:
        """Return a motion (T, joints) for all joints of the plant, (T, n) [rad]."""
        every = np.zeros((len(position), N))
        every[:, self.moving] = position
        return every

    def told(self, effect: dict) -> dict:
        """Return what was hidden, as it is called and measured on this arm."""
        number = {joint + 1: k + 1 for k, joint in enumerate(self.moving)}
        fixed = effect["effect"] in _ANY_POSITION
        parameters = {
            name: value
            if fixed or name not in _TORQUES
            else (self.strength * np.array(value)).tolist()
            for name, value in effect["parameters"].items()
        }
        return effect | {
            "joints": [number[j] for j in effect["joints"] if j in number],
            "most_affected": number[effect["most_affected"]],
            "sizes": [effect["sizes"][j] for j in self.moving],
            "parameters": parameters,
        }

    def simulation(self, nominal: dict) -> tuple[dict, str]:
        """Return the simulation file of this arm, and the description that it refers to."""
        number = {joint + 1: k + 1 for k, joint in enumerate(self.moving)}
        effects = []
        for entry in nominal["effects"]:
            if entry.get("joint") in number:
                fixed = entry["effect"] in _ANY_POSITION
                sizes = {k: self.strength * entry[k] for k in _TORQUES & {*entry} if not fixed}
                effects.append(entry | sizes | {"joint": number[entry["joint"]]})
        arm = _lumped(_stated(nominal["inertials"]), self.moving)
        strong = arm._replace(mass=self.strength * arm.mass, inertia=self.strength * arm.inertia)
        limits = Limits(*(values[self.moving] for values in load()[1]))
        robot = _urdf(strong, limits, self.strength * EFFORT[self.moving])
        rest = {name: value for name, value in nominal.items() if name != "inertials"}
        return rest | {"robot": ROBOT, "effects": effects}, robot


USUAL = Variant()


def _stated(inertials: dict) -> Arm:
    """Return the arm with the bodies of a simulation file."""
    bodies = [inertials[f"link{i + 1}"] for i in range(N)]
    mass = np.array([body["mass"] for body in bodies])
    com = np.array([body["com"] for body in bodies])
    inertia = np.zeros((N, 3, 3))
    for i, body in enumerate(bodies):
        xx, xy, xz, yy, yz, zz = body["inertia"]
        inertia[i] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return load()[0]._replace(mass=mass, com=com, inertia=inertia)


def _lumped(arm: Arm, moving: list[int]) -> Arm:
    """Fix the links of joints that do not move to the links before, at angle zero."""
    for i in range(N - 1, 0, -1):
        if i in moving:
            continue
        R, o = arm.rotation[i], arm.offset[i]
        arm = add_body(arm, i - 1, arm.mass[i], o + R @ arm.com[i], R @ arm.inertia[i] @ R.T)
        rotation, offset = arm.rotation.copy(), arm.offset.copy()
        if i + 1 < len(rotation):
            rotation[i + 1], offset[i + 1] = R @ rotation[i + 1], o + R @ offset[i + 1]
        arm = arm._replace(rotation=rotation, offset=offset)
        arm = Arm(*(np.delete(part, i, axis=0) for part in arm[:-1]), arm.gravity)
    return arm


def _urdf(arm: Arm, limits: Limits, effort: np.ndarray) -> str:
    root = ET.Element("robot", name="arm")
    ET.SubElement(root, "link", name="base")
    for i in range(len(arm.mass)):
        link = ET.SubElement(root, "link", name=f"link{i + 1}")
        body = ET.SubElement(link, "inertial")
        ET.SubElement(body, "origin", xyz=_words(arm.com[i]))
        ET.SubElement(body, "mass", value=repr(float(arm.mass[i])))
        upper = arm.inertia[i][np.triu_indices(3)]
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        ET.SubElement(
            body, "inertia", {k: repr(float(x)) for k, x in zip(names, upper, strict=True)}
        )
        joint = ET.SubElement(root, "joint", name=f"joint{i + 1}", type="revolute")
        ET.SubElement(joint, "parent", link=f"link{i}" if i else "base")
        ET.SubElement(joint, "child", link=f"link{i + 1}")
        rpy = Rotation.from_matrix(arm.rotation[i]).as_euler("xyz")
        ET.SubElement(joint, "origin", xyz=_words(arm.offset[i]), rpy=_words(rpy))
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(
            joint, "limit", lower=repr(float(-limits.position[i])),
            upper=repr(float(limits.position[i])), velocity=repr(float(limits.velocity[i])),
            effort=repr(float(effort[i])),
        )  # fmt: skip
    return ET.tostring(root, encoding="unicode")


def _words(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values)
