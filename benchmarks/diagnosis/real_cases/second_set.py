"""A second set of real recordings with known physics, from sources that no setting has seen.

Rebuilds the cases from a folder of fetched sources; nothing of the sources is kept here. Each case
is a folder as `real_cases` of the first set has it: `robot.urdf`, `sim.yaml` (what one would
believe), `recording*.parquet`, `heldout*.parquet` and `truth.json` (what has to be named, may be
named as well, and must not be), so that the first set's scorer works on both. The truth is what
authors wrote of their machines or fitted themselves, never what limo found.

    python benchmarks/diagnosis/real_cases/second_set.py files
    python benchmarks/diagnosis/real_cases/second_set.py build SOURCES CASES
    python benchmarks/diagnosis/real_cases/second_set.py values CASES OUT

`files` prints what has to lie in SOURCES/OWNER+NAME/, `values` what `limo diagnose` wrote into
OUT/CASE/verdict.json beside the values that are known. The cases and their expected answers were
written down before any of them was diagnosed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
import yaml
from scipy.signal import butter, filtfilt

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    Table = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]  # time (T,), position, torque (T, n)
    Effects = list[dict[str, Any]]

EXAMPLE_ROBOTS = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
PANDA = EXAMPLE_ROBOTS / "panda_description/urdf/panda.urdf"  # inertias of Gaz et al. 2019


@dataclass(frozen=True)
class Source:
    """A public repository, and what is read of it."""

    repository: str
    commit: str
    licence: str
    paths: tuple[str, ...]

    def at(self, sources: Path) -> Path:
        """Return the folder that holds the fetched files."""
        return sources / self.repository.replace("/", "+")


@dataclass(frozen=True)
class Case:
    """One arm or joint: what is believed of it, what was recorded, and what is true."""

    source: Source
    robot: Callable[[Path], str]  # folder of the source -> URDF
    read: Callable[[Path], tuple[list[Table], list[Table]]]  # -> diagnosed, held out
    stated: Effects
    why: str  # how the truth is known, how columns and units are read
    tolerances: dict[str, float]
    effects: Effects = field(default_factory=list)  # that have to be named; none: a null
    true: Effects | None = None  # of a simulation that knows; None: no file can state it
    true_robot: Callable[[Path], str] | None = None
    accept_also: tuple[str, ...] = ()
    tolerated: tuple[str, ...] = ()
    must_not: tuple[str, ...] = ()
    moving: float = 0.0  # [rad/s] rows below are not scored: torque of a motor side at rest


# ------------------------------------------------------------------ what a simulation states
def friction(
    tau_c: Iterable[float], f_v: Iterable[float] = (), v_eps: float | list[float] = 0.05
) -> Effects:
    """Return dry and viscous friction of joints 1 to n."""
    tau_c = list(tau_c)
    widths = v_eps if isinstance(v_eps, list) else [v_eps] * len(tau_c)
    dry = [
        {"effect": "coulomb_friction", "joint": j, "tau_c": c, "v_eps": w}
        for j, (c, w) in enumerate(zip(tau_c, widths, strict=True), 1)
        if c
    ]
    return dry + each("viscous_friction", "f_v", f_v)


def each(effect: str, parameter: str, values: Iterable[float]) -> Effects:
    """Return one effect of every joint that has a value."""
    return [{"effect": effect, "joint": j, parameter: v} for j, v in enumerate(values, 1) if v]


def wanted(effect: str, joints: list[int], **accepted: list[float]) -> dict[str, Any]:
    """Return what has to be named, and the range of each value that is known."""
    return {"effect": effect, "joints": joints, "params": accepted}


# ------------------------------------------------------------------ robots
def chain(*links: dict[str, Any]) -> Callable[[Path], str]:
    """Return the URDF of links one behind the other, each a joint about y of its own frame.

    Args:
        links: mass [kg], com (3,) [m], moment [kg m^2] about y through com, at (3,) [m] of the
            joint in the frame of the link before; axis, where it is not y.
    """
    text = ['<robot name="bench"><link name="link0"/>']
    for j, link in enumerate(links, 1):
        at, com = (" ".join(map(str, link.get(k, (0, 0, 0)))) for k in ("at", "com"))
        side = link["moment"]
        text.append(
            f'<joint name="joint{j}" type="revolute"><parent link="link{j - 1}"/>'
            f'<child link="link{j}"/><origin xyz="{at}"/><axis xyz="{link.get("axis", "0 1 0")}"/>'
            '<limit lower="-10000" upper="10000" effort="1000" velocity="1000"/></joint>'
            f'<link name="link{j}"><inertial><origin xyz="{com}"/><mass value="{link["mass"]}"/>'
            f'<inertia ixx="{side}" ixy="0" ixz="0" iyy="{side}" iyz="0" izz="{side}"/>'
            "</inertial></link>"
        )
    return lambda _: "\n".join([*text, "</robot>"])


def of_file(path: str | Path, without: tuple[str, ...] = ()) -> Callable[[Path], str]:
    """Return a source's URDF without shapes, without some links, its fingers held still."""

    def write(source: Path) -> str:
        root = ET.parse(source / path).getroot()  # noqa: S314  # at a stated commit
        for link in root.findall("link"):
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)
        for joint in root.findall("joint"):
            child = joint.find("child")
            if child is not None and child.get("link") in without:
                root.remove(joint)
            elif "finger" in str(joint.get("name")):
                joint.set("type", "fixed")
                for part in joint.findall("mimic"):
                    joint.remove(part)
        for link in [link for link in root.findall("link") if link.get("name") in without]:
            root.remove(link)
        return ET.tostring(root, "unicode")

    return write


# ------------------------------------------------------------------ recordings
def rows(time: Any, position: Any, torque: Any) -> Table:  # noqa: ANN401  # arrays of any shape
    """Return a recording whose times begin at 0 and rise."""
    time = np.ravel(time)
    position, torque = (np.reshape(x, (len(time), -1)) for x in (position, torque))
    rising = np.flatnonzero(np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]])
    return time[rising] - time[rising[0]], position[rising], torque[rising]


def cut(table: Table, at: float) -> tuple[list[Table], list[Table]]:
    """Return the first share of a recording, and the rest."""
    k = int(at * len(table[0]))
    time, position, torque = table
    return [rows(time[:k], position[:k], torque[:k])], [rows(time[k:], position[k:], torque[k:])]


def csv(path: Path, names: tuple[int, ...], joints: int, header: int = 1) -> Table:
    """Return columns of a CSV: time, first position, first torque, all in SI."""
    data = np.loadtxt(path, delimiter=",", skiprows=header)
    time, position, torque = names
    return rows(
        data[:, time], data[:, position : position + joints], data[:, torque : torque + joints]
    )


def both(
    read: Callable[[str], Table], diagnosed: tuple[str, ...], heldout: tuple[str, ...]
) -> tuple[list[Table], list[Table]]:
    """Return whole recordings, some diagnosed and some held out."""
    return [read(name) for name in diagnosed], [read(name) for name in heldout]


def kinova(folder: Path, run: str) -> Table:
    """Return a run of the Kinova: rad that wrap are unwrapped, torques are in N m."""
    time, q, tau = (
        np.loadtxt(folder / f"{KINOVA_DATA}/{name}_downsampled_{run}.csv")
        for name in ("t", "q", "tau")
    )
    return rows(time, np.unwrap(q, axis=0), tau)


def panda(folder: Path) -> Table:
    """Return the exciting motion of the Panda, 1 kHz, every second row."""
    log = folder / "matlab/data/Exciting_Traj/Trajectory_1/rbt_log"
    time, q, tau = (
        np.loadtxt(log / f"exciting_traj_{name}.txt").reshape(-1, width)[::2]
        for name, width in (("time", 1), ("positions", 7), ("torques", 7))
    )
    return rows(time, q, tau)


def servo(folder: Path, run: str) -> Table:
    """Return a run of the servo motor, 1 kHz; torque is 0.0458 N m/A times the current.

    limo takes angles beyond 1000 rad for another unit, so that a run ends there.
    """
    data = scipy.io.loadmat(folder / f"Data/Identification/idf_{run}.mat")["data"]
    data = data[np.abs(data[:, 2]) < 990.0]
    return rows(data[:, 0], data[:, 2], data[:, 5])


def flexible_link(folder: Path) -> Table:
    """Return the motor of the flexible link: deg, and torque from volts by the maker's constants.

    efficiencies 0.9 and 0.69, gear 70, 7.68e-3 N m/A and V s/rad, 2.6 ohm; speed from the angle.
    """
    angle, volts = (
        scipy.io.loadmat(folder / f"Data/data_{name}.mat")[f"data_{name}"]
        for name in ("theta", "vm")
    )
    q = np.radians(angle[:, 2])
    b, a = butter(4, 2 * 20 * 0.002)
    speed = np.gradient(filtfilt(b, a, q), 0.002)
    torque = 0.9 * 70 * 0.69 * 7.68e-3 / 2.6 * (volts[:, 1] - 70 * 7.68e-3 * speed)
    return rows(angle[:, 0], q, torque)


def cart(folder: Path, run: str) -> Table:
    """Return a cart on its rail as a joint of unit radius: m is rad, N is N m, kg is kg m^2.

    Force is the current times 93.4e-3 N m/A over the pulley's radius of 0.028 m.
    """
    data = np.loadtxt(folder / f"parameterEstimation/data/cartTest3/0m{run}.csv", delimiter=",")
    return rows(data[2:, 0], data[2:, 2], data[2:, 1] * 93.4e-3 / 0.028)


def light_arm(folder: Path) -> Table:
    """Return the arm of seven joints of which only the third moves, 26 Hz, rad and N m."""
    data = np.load(folder / "results/real_friction_identification_joint_3.npz")
    return rows(data["time"], data["q"], data["tau_measured"])


# ------------------------------------------------------------------ sources
KINOVA_DATA = "Examples/Kinova/SystemIdentification/IterativeSystemIdentification/full_params_data"
PENDULUM = Source(
    "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
    "ed17ea2d32a35ad944944ca03ef57693e2986732",
    "BSD-3-Clause",
    tuple(f"results/control_method_{m}/data_measured.csv" for m in ("ddp", "direct_collocation")),
)
DOUBLE_A = "data/experiment_records/design_A.0/20220815/sys_id/trajectory_"
DOUBLE_C0 = "data/experiment_records/design_C.0/20220914/sys_id/trajectory_"
DOUBLE_C1 = "data/experiment_records/design_C.1/sys_id/20230629/20230629-"
DOUBLE = Source(
    "dfki-ric-underactuated-lab/double_pendulum",
    "1e8544e67f3da72a51ee52fbbb278e131ce2a43f",
    "BSD-3-Clause",
    (
        *(f"{DOUBLE_A}{n}.csv" for n in ("01", "02", "03", "05")),
        *(f"{DOUBLE_C0}{n}.csv" for n in ("01", "02", "04", "05", "06")),
        *(
            f"{DOUBLE_C1}{n}/trajectory.csv"
            for n in ("143524", "143601", "144115", "143747", "144003")
        ),
    ),
)
KINOVA = Source(
    "roahmlab/RAPTOR",
    "04daa66070b6548b2139ff43bdffbc6a71a3c992",
    "GPL-3.0",
    (
        "Robots/kinova-gen3/kinova.urdf",
        *(f"{KINOVA_DATA}/{k}_downsampled_{n}.csv" for k in ("t", "q", "tau") for n in "24"),
    ),
)
GAZ = Source(
    "marcocognetti/FrankaEmikaPandaDynModel",
    "24d85ce4e648e2e894c832bfeee9b16711eb1a1a",
    "GPL-3.0",
    tuple(
        f"matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj_{k}.txt"
        for k in ("time", "positions", "torques")
    ),
)
SERVO_RUNS = ("neg_0.045_1", "neg_0.04_1", "pos_0.065_1", "pos_0.06_1")
SERVO_HELD_OUT = ("neg_0.045_3", "pos_0.065_3")
SERVO = Source(
    "malik-robert/HSM150-data",
    "35c3b1be8a4c2215ff981eb00bb3ed439e9f524b",
    "none stated",
    tuple(f"Data/Identification/idf_{n}.mat" for n in (*SERVO_RUNS, *SERVO_HELD_OUT)),
)
QUANSER = Source(
    "gleylaz/Optimal_SysID",
    "6eacf84a3d639e0f976bd1451b0ef6771ab7a46d",
    "none stated",
    ("Data/data_theta.mat", "Data/data_vm.mat"),
)
CART_RUNS, CART_HELD_OUT = ("08", "20", "32", "44", "56", "68"), ("14", "38", "62")
CART = Source(
    "nielsSkov/masterThesisMatlab",
    "0e2c7253fe6e740c36da872508a71c0d1f66a965",
    "none stated",
    tuple(f"parameterEstimation/data/cartTest3/0m{n}.csv" for n in CART_RUNS + CART_HELD_OUT),
)
LIGHT_ARM = Source(
    "YIZHIXIAOCANGSHU/Friction-Identification-for-Manipulators",
    "f915751262ab6c43dc436b7395f41b03f2e8ee2b",
    "none stated",
    (
        "am_d02_model/urdf/AM-D02-AemLURDF0413.urdf",
        "results/real_friction_identification_joint_3.npz",
    ),
)

# ------------------------------------------------------------------ what is known of each machine
FRICTION_NAMES = (
    "coulomb_friction",
    "viscous_friction",
    "asymmetric_friction",
    "torque_offset",
    "stribeck_friction",
)
NO_MECHANISM = ("spring_load", "gravity_direction", "torque_ripple", "backlash", "time_delay")
HELD_BY_AN_ARM = (*NO_MECHANISM, "payload", "joint_elasticity", "encoder_offset", "torque_gain")

POINT_MASS = {"com": (0, 0, -0.5), "moment": 1e-5}
SWING = friction([0.184], [0.047])
# authors' I1, I2 are about the joints; I of a rotor times 36 is the armature of its joint
DOUBLE_A0 = chain(
    {"mass": 0.55938, "com": (0, 0, -0.3), "moment": 0.00313},
    {"at": (0, 0, -0.3), "mass": 0.60435, "com": (0, 0, -0.18378), "moment": 0.00351},
)
DOUBLE_C0_ROBOT = chain(
    {"mass": 0.54762, "com": (0, 0, -0.2), "moment": 0.00231},
    {"at": (0, 0, -0.2), "mass": 0.59786, "com": (0, 0, -0.275), "moment": 0.00824},
)
DOUBLE_C1_ROBOT = chain(
    {"mass": 0.52346, "com": (0, 0, -0.2), "moment": 0.01095},
    {"at": (0, 0, -0.2), "mass": 0.62557, "com": (0, 0, -0.25569), "moment": 0.00997},
)
ROTORS_A0 = each("armature", "inertia", (0.00276, 0.00276))
ROTORS_C = each("armature", "inertia", (0.00226, 0.00226))
OLD_C = friction([0.0928, 0.0771], [0.01108, 0.0044])
NEW_C = friction([0.16, 0.12], [0.001, 0.001])
# authors' fit over all five runs (friction_parameters_solution_6.csv)
KINOVA_DRY = (0.0784, 0.3555, 0.3952, 0.4535, 0.093, 0.1169, 0.1995)
KINOVA_VISCOUS = (11.315, 13.08, 10.842, 11.594, 9.804, 10.623, 9.61)
KINOVA_ROTORS = (7.485, 7.321, 7.846, 7.529, 7.428, 7.381, 7.725)
# authors' sigmoid A / (1 + exp(-k (v + s))) less its value at rest: A / 2 tanh(k (v + s) / 2)
GAZ_A = (0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489)
GAZ_K = (5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336)
GAZ_S = (0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526)
GAZ_FRICTION = friction([a / 2 for a in GAZ_A], v_eps=[2 / k for k in GAZ_K])
GAZ_OFFSET = each(
    "torque_offset",
    "offset",
    [-a / 2 * float(np.tanh(k * s / 2)) for a, k, s in zip(GAZ_A, GAZ_K, GAZ_S, strict=True)],
)
BARE_PANDA = of_file(
    PANDA, without=("panda_hand", "panda_hand_tcp", "panda_leftfinger", "panda_rightfinger")
)


def double(runs: str, suffix: str, diagnosed: tuple[str, ...], heldout: tuple[str, ...]) -> Any:  # noqa: ANN401
    """Return the reader of one design of the double pendulum: rad, N m of the drives."""
    return lambda folder: both(
        lambda n: csv(folder / f"{runs}{n}{suffix}.csv", (0, 1, 13), 2), diagnosed, heldout
    )


CASES = {
    "pendulum_mass": Case(
        PENDULUM,
        chain({**POINT_MASS, "mass": 0.57288}),
        lambda f: both(
            lambda n: csv(f / f"results/control_method_{n}/data_measured.csv", (0, 1, 3), 1),
            ("ddp",),
            ("direct_collocation",),
        ),
        SWING,
        "simulations of the authors take 0.573 kg at 0.5 m, the parameters of the real bench "
        "0.6755 kg; least squares of our own on the swing-up: 0.664 kg. Friction is the authors' "
        "fit. Drive AK80-6, torque as it reports it",
        {"inertia": 0.05, "friction": 0.2},
        effects=[wanted("payload", [1], mass=[0.05, 0.15])],
        true=SWING,
        true_robot=chain({**POINT_MASS, "mass": 0.6755}),
        accept_also=("link_inertia", "torque_gain"),
        tolerated=(*FRICTION_NAMES, "armature"),
        must_not=("spring_load", "torque_ripple", "backlash", "time_delay"),
        moving=0.2,
    ),
    "double_a0_null": Case(
        DOUBLE,
        DOUBLE_A0,
        double(DOUBLE_A, "", ("01", "02", "03"), ("05",)),
        friction([0.093, 0.078], [0.001, 0.001]) + ROTORS_A0,
        "authors' identified model 2.0 of design A.0; held out is a run of another chirp",
        {"inertia": 0.1, "friction": 0.3},
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia"),
        must_not=HELD_BY_AN_ARM,
        moving=0.2,
    ),
    "double_c0_friction": Case(
        DOUBLE,
        DOUBLE_C0_ROBOT,
        double(DOUBLE_C0, "", ("01", "02", "04"), ("05", "06")),
        ROTORS_C,
        "authors' model h1.0 of design C.0, of which friction is not stated",
        {"inertia": 0.1, "friction": 0.15},
        effects=[wanted("coulomb_friction", [1, 2], tau_c=[0.05, 0.16])],
        true=OLD_C + ROTORS_C,
        accept_also=("viscous_friction", "asymmetric_friction", "presliding_hysteresis"),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia"),
        must_not=HELD_BY_AN_ARM,
        moving=0.2,
    ),
    "double_c1_friction_grew": Case(
        DOUBLE,
        DOUBLE_C1_ROBOT,
        double(DOUBLE_C1, "/trajectory", ("143524", "143601", "144115"), ("143747", "144003")),
        OLD_C + ROTORS_C,
        "design C.1 of 2023 with the friction that the same drives had in 2022: the authors' fit "
        "grew from 0.093 and 0.077 to 0.16 and 0.12 N m",
        {"inertia": 0.1, "friction": 0.15},
        effects=[wanted("coulomb_friction", [1, 2], tau_c=[0.1, 0.24])],
        true=NEW_C + ROTORS_C,
        accept_also=("asymmetric_friction", "presliding_hysteresis"),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia"),
        must_not=HELD_BY_AN_ARM,
        moving=0.2,
    ),
    "kinova_null": Case(
        KINOVA,
        of_file("Robots/kinova-gen3/kinova.urdf"),
        lambda f: both(lambda n: kinova(f, n), ("2",), ("4",)),
        friction(KINOVA_DRY, KINOVA_VISCOUS) + each("armature", "inertia", KINOVA_ROTORS),
        "the maker's inertias, the authors' friction and armature over all runs; torques beyond "
        "what the small drives are rated for: what they are is the authors' word",
        {"inertia": 0.05, "friction": 0.2},
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia", "presliding_hysteresis"),
        must_not=("time_delay", "joint_elasticity", "spring_load", "gravity_direction", "backlash"),
        moving=0.05,
    ),
    "kinova_armature": Case(
        KINOVA,
        of_file("Robots/kinova-gen3/kinova.urdf"),
        lambda f: both(lambda n: kinova(f, n), ("2",), ("4",)),
        friction(KINOVA_DRY, KINOVA_VISCOUS),
        "as kinova_null, with the armatures left out: the authors' fits are 7.1 to 8.1 kg m^2",
        {"inertia": 0.05, "friction": 0.2},
        effects=[wanted("armature", [1, 2, 3, 4, 5, 6, 7], inertia=[6.0, 9.0])],
        true=friction(KINOVA_DRY, KINOVA_VISCOUS) + each("armature", "inertia", KINOVA_ROTORS),
        tolerated=(*FRICTION_NAMES, "link_inertia", "presliding_hysteresis"),
        must_not=("time_delay", "joint_elasticity", "spring_load", "gravity_direction", "backlash"),
        moving=0.05,
    ),
    "panda_null": Case(
        GAZ,
        BARE_PANDA,
        lambda f: cut(panda(f), 2 / 3),
        GAZ_FRICTION + GAZ_OFFSET,
        "inertias and friction that the authors identified, flange bare; torques of the link side",
        {"inertia": 0.05, "friction": 0.15},
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia", "presliding_hysteresis"),
        must_not=HELD_BY_AN_ARM,
    ),
    "panda_friction": Case(
        GAZ,
        BARE_PANDA,
        lambda f: cut(panda(f), 2 / 3),
        [],
        "as panda_null, friction not stated: the authors' is 0.15 to 0.64 N m, blunt around rest",
        {"inertia": 0.05, "friction": 0.15},
        effects=[wanted("coulomb_friction", [1, 2, 3, 4, 5, 6, 7], tau_c=[0.12, 0.7])],
        true=GAZ_FRICTION + GAZ_OFFSET,
        accept_also=("viscous_friction", "asymmetric_friction", "presliding_hysteresis"),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia", "presliding_hysteresis"),
        must_not=HELD_BY_AN_ARM,
    ),
    "panda_no_hand": Case(
        GAZ,
        of_file(PANDA),
        lambda f: cut(panda(f), 2 / 3),
        GAZ_FRICTION + GAZ_OFFSET,
        "the simulation carries the hand of 0.76 kg, the arm has a bare flange: least squares of "
        "our own gives the torques of the bare arm gains of 1.00, 1.00, 1.03, 1.00",
        {"inertia": 0.05, "friction": 0.15},
        effects=[wanted("link_inertia", [7])],
        true=GAZ_FRICTION + GAZ_OFFSET,
        true_robot=BARE_PANDA,
        accept_also=("payload",),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia", "presliding_hysteresis"),
        must_not=(*NO_MECHANISM, "joint_elasticity", "encoder_offset", "torque_gain"),
    ),
    "servo_friction": Case(
        SERVO,
        chain({"mass": 0.1, "moment": 1.2e-4, "axis": "0 0 1"}),
        lambda f: both(
            lambda n: servo(f, n),
            SERVO_RUNS,
            SERVO_HELD_OUT,
        ),
        each("viscous_friction", "f_v", [7.03e-5]),
        "catalogue: 1.2e-4 kg m^2 and 7.03e-5 N m s/rad; least squares of our own on twelve runs: "
        "0.9e-4 to 1.3e-4, 5.8e-5 to 7.9e-5, and dry friction of 0.042 forward, 0.028 backward",
        {"inertia": 0.1, "friction": 0.15},
        effects=[wanted("coulomb_friction", [1], tau_c=[0.025, 0.045])],
        true=[
            {"effect": "coulomb_friction", "joint": 1, "tau_c": 0.035, "v_eps": 1.0},
            {"effect": "torque_offset", "joint": 1, "offset": 0.007},
            *each("viscous_friction", "f_v", [7.03e-5]),
        ],
        accept_also=("asymmetric_friction", "torque_offset"),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia"),
        must_not=("spring_load", "payload", "gravity_direction", "backlash", "joint_elasticity"),
        moving=5.0,
    ),
    "flexible_link": Case(
        QUANSER,
        chain({"mass": 0.065, "moment": 0.0038, "axis": "0 0 1"}),
        lambda f: cut(flexible_link(f), 2 / 3),
        each("armature", "inertia", [0.00208]) + each("viscous_friction", "f_v", [0.025]),
        "the beam is clamped to the hub: 1.3 N m/rad by its natural frequency (authors), 1.19 by "
        "least squares of our own with its strain gauge; the authors name Coulomb friction, too, "
        "0.015 N m by our fit; no file states a beam that swings: no error is given with the truth",
        {"inertia": 0.1, "friction": 0.3},
        effects=[
            wanted("joint_elasticity", [1], stiffness=[0.9, 1.6]),
            wanted("coulomb_friction", [1], tau_c=[0.005, 0.03]),
        ],
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia"),
        must_not=("gravity_direction", "payload", "backlash", "torque_ripple"),
    ),
    "cart_friction": Case(
        CART,
        chain({"mass": 0.1, "moment": 6.28, "axis": "0 0 1"}),
        lambda f: both(lambda n: cart(f, n), CART_RUNS, CART_HELD_OUT),
        [],
        "6.28 kg; the authors' dry friction is 2.4 to 3.6 N one way and 6.0 to 2.3 N the other, "
        "by the place on the rail; least squares of our own: 6.4 to 6.7 kg, half sum 1.6, half "
        "difference -1.5 to -0.1 N",
        {"inertia": 0.05, "friction": 0.15},
        effects=[wanted("coulomb_friction", [1], tau_c=[1.0, 4.5])],
        true=[
            *friction([1.7], v_eps=0.005),
            {"effect": "torque_offset", "joint": 1, "offset": -1.0},
        ],
        accept_also=("asymmetric_friction", "position_dependent_friction"),
        tolerated=(*FRICTION_NAMES, "armature", "link_inertia", "position_dependent_friction"),
        must_not=("torque_ripple", "gravity_direction", "backlash", "payload", "spring_load"),
        moving=0.02,
    ),
    "light_arm_joint_3": Case(
        LIGHT_ARM,
        of_file("am_d02_model/urdf/AM-D02-AemLURDF0413.urdf"),
        lambda f: cut(light_arm(f), 2 / 3),
        [],
        "the authors' fit of joint 3: 0.338 N m and 0.266 N m s/rad; least squares of our own "
        "0.335 and 0.259; nothing else moves",
        {"inertia": 0.2, "friction": 0.15},
        effects=[wanted("coulomb_friction", [3], tau_c=[0.25, 0.42])],
        true=[
            {"effect": "coulomb_friction", "joint": 3, "tau_c": 0.338, "v_eps": 0.05},
            {"effect": "viscous_friction", "joint": 3, "f_v": 0.266},
        ],
        accept_also=("asymmetric_friction",),
        tolerated=(*FRICTION_NAMES, "armature", "presliding_hysteresis"),
        must_not=("spring_load", "payload", "gravity_direction", "backlash", "torque_ripple"),
        moving=0.05,
    ),
}


# ------------------------------------------------------------------ writing and comparing
def build(name: str, case: Case, sources: Path, out: Path) -> None:
    """Write one case, and how well the simulations without and with the truth predict."""
    folder, source = out / name, case.source.at(sources)
    folder.mkdir(parents=True, exist_ok=True)
    known = "known.urdf" if case.true_robot else "robot.urdf"
    (folder / "robot.urdf").write_text(case.robot(source))
    if case.true_robot:
        (folder / known).write_text(case.true_robot(source))
    for file, robot, effects in (
        ("sim.yaml", "robot.urdf", case.stated),
        ("known.yaml", known, case.true),
    ):
        if effects is None:
            continue
        simulation = {"robot": robot, "tolerances": case.tolerances, "effects": effects}
        (folder / file).write_text(yaml.safe_dump(simulation, sort_keys=False))
    files: dict[str, list[str]] = {}
    for kind, tables in zip(("recording", "heldout"), case.read(source), strict=True):
        files[kind] = [
            f"{kind}{f'_{i}' if i > 1 else ''}.parquet" for i in range(1, len(tables) + 1)
        ]
        for file, (time, position, torque) in zip(files[kind], tables, strict=True):
            columns = {"time": time}
            for label, values in (("position", position), ("torque", torque)):
                columns |= {f"{label}_{j}": x for j, x in enumerate(values.T, 1)}
            pq.write_table(pa.table(columns), folder / file)
    truth = {
        "case": name,
        "kind": "truth" if case.effects else "negative",
        "effects": case.effects,
        "accept_also": case.accept_also,
        "tolerated": case.tolerated,
        "must_not": case.must_not,
        "note": f"{case.source.repository} {case.source.commit[:8]}: {case.why}",
        "recordings": files["recording"],
        "heldout": files["heldout"],
        "score_rows": {"speed_above": case.moving, "filter_hz": 8} if case.moving else None,
        "rmse_before": errors(folder, files["heldout"], "sim.yaml", case.moving),
        "rmse_with_effect": errors(folder, files["heldout"], "known.yaml", case.moving)
        if case.true is not None
        else None,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    print(name, truth["rmse_before"], truth["rmse_with_effect"], flush=True)


def errors(folder: Path, files: list[str], simulation: str, moving: float) -> list[float]:
    """Return the RMSE [N m] by joint of `limo predict` over the rows that are scored, (n,)."""
    wrong = []
    for file in files:
        out = folder / f"predicted_by_{Path(simulation).stem}.parquet"
        command = ["predict", folder / file, "--sim", folder / simulation, "--out", out]
        run = "from limo_driver.app.cli import main; main()"
        subprocess.run([sys.executable, "-c", run, *map(str, command)], check=True)
        recorded, predicted = pq.read_table(folder / file), pq.read_table(out)
        joints = range(1, predicted.num_columns)
        time, q, tau = (
            np.column_stack([recorded[c].to_numpy() for c in names])
            for names in (["time"], *([f"{k}_{j}" for j in joints] for k in ("position", "torque")))
        )
        step = float(np.median(np.diff(time[:, 0])))
        b, a = butter(4, min(2 * 8 * step, 0.95))
        fast = np.abs(np.gradient(filtfilt(b, a, q, axis=0), step, axis=0)) > moving
        model = np.column_stack([predicted[f"torque_{j}"].to_numpy() for j in joints])
        wrong.append(np.where(fast | (moving == 0), tau - model, np.nan))
    return [float(x) for x in np.sqrt(np.nanmean(np.concatenate(wrong) ** 2, axis=0))]


def values(cases: Path, out: Path) -> None:
    """Print every value told of an effect whose range is known, and whether it lies there."""
    for name in CASES:
        truth = json.loads((cases / name / "truth.json").read_text())
        verdict = json.loads((out / name / "verdict.json").read_text())
        told = [*verdict["findings"], *verdict.get("identified", [])]
        for want in truth["effects"]:
            for item in (item for item in told if item["effect"] == want["effect"]):
                for key, (low, high) in want["params"].items():
                    value = np.ravel(item["parameters"].get(key, {}).get("value", np.nan))
                    inside = "inside" if np.all((low <= value) & (value <= high)) else "OUTSIDE"
                    joints = item.get("joints", [item.get("joint")])
                    print(name, want["effect"], joints, key, value, inside, [low, high])


def main() -> None:
    """Print what to fetch, build the cases, or print values beside what is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("files", "build", "values"))
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--only", nargs="*", help="names of cases")
    options = parser.parse_args()
    if options.action == "files":
        for source in {case.source.repository: case.source for case in CASES.values()}.values():
            print(f"{source.repository}@{source.commit} ({source.licence})")
            print(*(f"  {path}" for path in source.paths), sep="\n")
    elif options.action == "build":
        for name, case in CASES.items():
            if not options.only or name in options.only:
                build(name, case, *options.folders)
    else:
        values(*options.folders)


if __name__ == "__main__":
    main()
