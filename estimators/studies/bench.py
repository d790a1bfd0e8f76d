"""Benchmarks of others on limo as anybody would call it, on files that a user has.

Each is learned from the files that its authors learn from, and judged on theirs by their measure.
Next to limo's figures stands theirs: of EMPS their own procedure, run here; of NNFM the
predictions that the authors publish in the same file; of the two arms, whose description has to be
in the folder, a linear regression on the motion. limo's are named by the command: what it
identifies, what it trains by default, joint physics, and where PyTorch is installed, networks.

Source: Janot, Gautier and Brunot, "Data set and reference models of EMPS", Workshop on Nonlinear
System Identification Benchmarks 2019 (DATA_EMPS.mat, DATA_EMPS_PULSES.mat); Long et al., "NNFM: A
novel neural network modeling approach for robot flexible joints friction", whose repository has
case1_high.csv to case4_slow.csv; Weigand, Götz, Ulmen and Ruskowski, "Dataset and baseline for an
industrial robot identification benchmark", 2022 (KR300); Valencia-Vidal et al., "Bidirectional
recurrent learning of inverse dynamic models for robots with elastic joints", Frontiers in
Neurorobotics 2023, whose repository Baxter_Dynamic_Model has folders Training and Test.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from estimators.hybrid import HybridModel
from estimators.hybrid.training.settings import usual_settings
from estimators.joint_physics import JointPhysics
from estimators.rigid_body import Rows, identify
from estimators.rigid_body.best_bandwidth import fitting_bandwidth
from estimators.studies.model_choice import best_model
from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray

EMPS: Final = ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")
SPEEDS: Final = ("high", "middle", "slow")
KR300: Final = ("inverse_identification_without_raw_data.mat", "kr300.urdf")
BAXTER: Final = "baxter.urdf"
_GEARS: Final = (212.76, 203.52, 192.75, 156.0, 156.0, 102.17)  # of the KR300, by its authors
_NETWORKS: Final = ("mlp7", "lru", "gru") if find_spec("torch") else ()
_STEPS: Final = 0.1, 0.01  # [s], of KR300 and Baxter
_PEERS: Final = ("CV", "Stribeck", "SVM", "Light_Transformer", "PINN", "NNFM")  # in their files
_EDGE, _THINNED = 50, 10  # rows, as in the authors' script
_CUT: Final = 100.0  # [Hz] of their Butterworth filter
_HEARD: Final = 10.0  # [Hz] of the zero-phase filter behind which NNFM is judged, by its authors
_ARM: Final = """<robot name="{name}"><link name="base"/><link name="body"><inertial>
<origin xyz="0 0 0"/><mass value="{mass}"/><inertia ixx="{about}" iyy="{about}" izz="{about}"
ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="{name}" type="{kind}"><parent link="base"/>
<child link="body"/><axis xyz="{axis}"/><limit lower="-10" upper="10" velocity="10" effort="1000"/>
</joint></robot>"""


@dataclass(frozen=True)
class BenchRow:
    """A figure on one benchmark."""

    benchmark: str
    measure: str  # with its unit
    who: str
    figure: float
    source: str  # where it is from


_Ours: TypeAlias = "tuple[str, str, Callable[[Recording], FloatArray]]"


def bench(folder: Path, tell: Callable[[str], None] = lambda _: None) -> tuple[BenchRow, ...]:
    """Compute all benchmarks whose files are in a folder.

    Args:
        folder: With the authors' files, under their names, in it or in folders below.
        tell: Told what is computed next, and each figure as it comes.

    Raises:
        RecordingError: No benchmark's files are there, or one is not as its authors made it.
    """
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    rows: list[BenchRow] = []

    def keep(found: Iterable[BenchRow]) -> None:
        for row in found:
            tell(f"{row.benchmark}, {row.who}: {row.figure:.4g}")
            rows.append(row)

    if all(name in files for name in EMPS):
        tell("computing EMPS")
        keep(_emps(*(files[name] for name in EMPS)))
    for case in range(1, 5):
        names = [f"case{case}_{speed}.csv" for speed in SPEEDS]
        if all(name in files for name in names):
            tell(f"computing NNFM, case {case}")
            keep(_friction(case, [files[name] for name in names]))
    if all(name in files for name in KR300):
        tell("computing KR300")
        data = industrial(files[KR300[0]])
        keep(_arm("KR300, inverse", "mean NRMSE", str(files[KR300[1]]), *data))
    trips = [sorted(folder.rglob(f"{part}/*_ang_vel_torq.csv")) for part in ("Training", "Test")]
    if BAXTER in files and all(trips):
        tell("computing Baxter")
        data = [[trip(path) for path in paths] for paths in trips]
        keep(_arm("Baxter, left arm", "MAE [N m]", f"{files[BAXTER]}#left_[sew][012]", *data))
    if not rows:
        raise RecordingError(
            f"has the files of no benchmark, expected {' and '.join(EMPS)}, or case1_high.csv, "
            f"case1_middle.csv and case1_slow.csv (likewise cases 2 to 4), or {' and '.join(KR300)}"
            f", or {BAXTER} and folders Training and Test of *_ang_vel_torq.csv",
            path=folder,
        )
    return tuple(rows)


def _emps(learned: Path, test: Path) -> Iterator[BenchRow]:
    """Give the relative error of the force of the slide on the file with pulses."""
    (train, training), (judged, tested) = (_slide(path) for path in (learned, test))
    of = "EMPS, pulses", "relative force error [%]"
    measured = _thinned(tested.force)

    def error(predicted: FloatArray) -> float:
        """Return the error on all rows of the file, those that limo leaves out among them."""
        if len(predicted) < len(tested.time):
            predicted = np.interp(tested.time, judged.time, predicted)
        left = measured - _thinned(predicted)
        return float(100.0 * np.linalg.norm(left) / np.linalg.norm(measured))

    known = np.stack([_thinned(column) for column in training.columns.T], axis=1)
    weights = np.linalg.lstsq(known, _thinned(training.force), rcond=None)[0]
    peer = tested.columns @ weights
    yield BenchRow(*of, "IDIM-LS", error(peer), "Script_IDIM_LS.m, its procedure run here")
    for who, source, predict in _of_joint("slide", "prismatic", "1 0 0", 100.0, [train]):
        yield BenchRow(*of, who, error(predict(judged)[:, 0]), source)


@dataclass(frozen=True)
class SlideFile:
    """What a file of the EMPS has, every row of it."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T,) [m]
    force: FloatArray  # (T,) [N]

    @property
    def columns(self) -> FloatArray:
        """Acceleration, velocity, its sign and one, (T, 4), as the authors compute them."""
        from scipy.signal import butter, sosfiltfilt

        step = float(np.mean(np.diff(self.time)))
        sections = np.asarray(butter(4, 2.0 * _CUT * step, output="sos"))
        velocity = np.gradient(np.asarray(sosfiltfilt(sections, self.position)), step)
        acceleration = np.gradient(velocity, step)
        return np.stack([acceleration, velocity, np.sign(velocity), np.ones_like(velocity)], axis=1)


def _slide(path: Path) -> tuple[Recording, SlideFile]:
    """Read position [m] and force [N] of the slide, the rows that limo uses and all of them."""
    from scipy.io import loadmat

    with _as_made(path, "file of the EMPS, which has t, qm, vir and gtau"):
        values: dict[str, Any] = loadmat(path)
        time, position, force = (values[name].ravel() for name in ("t", "qm", "vir"))
        force = force * float(values["gtau"].ravel()[0])
    raw = SlideFile(time, position, force)
    return Recording.from_arrays(time, position[:, None], force[:, None]), raw


def _thinned(values: FloatArray) -> FloatArray:
    from scipy.signal import decimate

    return np.asarray(decimate(values[_EDGE - 1 :], _THINNED))


def _friction(case: int, paths: list[Path]) -> Iterator[BenchRow]:
    """Give the RMS error of the friction of a joint at each speed, learned from the other two."""
    read = [_friction_of(path) for path in paths]
    joint = read[0][2]
    for k, (speed, (judged, peers, _)) in enumerate(zip(SPEEDS, read, strict=True)):
        others = [one for i, (one, _, _) in enumerate(read) if i != k]
        of = f"NNFM, joint {joint}, {speed} (case {case})", f"RMS below {_HEARD:g} Hz [N m]"

        def error(predicted: FloatArray, judged: Recording = judged) -> float:
            left = judged.filtered((predicted - judged.torque[:, 0])[:, None], _HEARD)
            return float(np.sqrt(np.mean(left**2)))

        for name, predicted in peers.items():
            yield BenchRow(*of, name, error(predicted), f"predictions in {paths[k].name}")
        own = _of_joint(f"joint{joint}", "revolute", "0 0 1", 1e-3, others)
        for who, source, predict in own:
            figure = error(predict(judged)[:, 0])
            yield BenchRow(*of, who, figure, f"learned from the other speeds, {source}")


def _friction_of(path: Path) -> tuple[Recording, dict[str, FloatArray], str]:
    """Read motion and friction of a joint, the peers' predictions, and the joint's number."""
    from pyarrow.csv import read_csv

    with _as_made(path, f"comparison of NNFM, which has time, q, friction, {', '.join(_PEERS)}"):
        table = read_csv(path)
        joint = table.column_names[1].removeprefix("q")
        named = ("time", f"q{joint}", f"q{joint}_tau_J_compensate")
        time, position, torque = (table[name].to_numpy() for name in named)
        peers = {name: table[name].to_numpy() for name in _PEERS}
    recording = Recording.from_arrays(time, position[:, None], torque[:, None])
    kept = slice(None) if recording.rows is None else recording.rows
    return recording, {name: values[kept] for name, values in peers.items()}, joint


def _arm(
    benchmark: str, measure: str, robot: str, learned: list[Recording], tests: list[Recording]
) -> Iterator[BenchRow]:
    """Give the error of an arm's torque over all rows of the tests, the mean of its joints."""
    width, _ = fitting_bandwidth(RobotModel.load(robot), learned)

    def terms(one: Recording) -> FloatArray:
        motion = one.motion(width)
        parts = motion.position, motion.velocity, motion.acceleration, np.ones((len(one), 1))
        return np.concatenate(parts, axis=1)

    known, torque = (
        np.concatenate(x) for x in zip(*((terms(r), r.torque) for r in learned), strict=True)
    )
    weights = np.linalg.lstsq(known, torque, rcond=None)[0]

    def linear(one: Recording) -> FloatArray:
        return terms(one) @ weights

    measured = np.concatenate([one.torque for one in tests])
    peer = ("linear in the motion", "run here", linear)
    for who, source, predict in chain([peer], _ours(robot, learned)):
        left = measured - np.concatenate([predict(one) for one in tests])
        each = np.sqrt(np.mean(left**2, axis=0)) / measured.std(axis=0)
        figure = np.mean(np.abs(left)) if measure.startswith("MAE") else each.mean()
        yield BenchRow(benchmark, measure, who, float(figure), source)


def industrial(path: Path) -> tuple[list[Recording], list[Recording]]:
    """Read angles [°] and torques of the motors [N m] of the KR300: to learn from, and the test."""
    from scipy.io import loadmat

    parts: list[list[Recording]] = []
    with _as_made(path, "file of the KR300, which has u and y, _train and _test"):
        values: dict[str, Any] = loadmat(path)
        for part in ("train", "test"):
            angle, torque = np.radians(values[f"u_{part}"][:6].T), values[f"y_{part}"].T
            time = _STEPS[0] * np.arange(len(angle))
            parts.append([Recording.from_arrays(time, angle, torque * _GEARS)])
    return parts[0], parts[1]


def trip(path: Path) -> Recording:
    """Read a recording of Baxter: angles, speeds and torques of seven joints."""
    with _as_made(path, "recording of Baxter, which has 21 columns"):
        values = np.loadtxt(path, skiprows=1)
        position, velocity, torque = np.split(values, 3, axis=1)
    time = _STEPS[1] * np.arange(len(values))
    return Recording.from_arrays(time, position, torque, velocity=velocity, source=str(path))


@contextmanager
def _as_made(path: Path, what: str) -> Generator[None]:
    """Refuse a file that is not as its authors made it."""
    try:
        yield
    except (LookupError, ValueError, NotImplementedError, OSError) as error:
        raise RecordingError(f"is no {what}: {error}", path=path) from None


def _of_joint(
    name: str, kind: str, axis: str, mass: float, learned: Sequence[Recording]
) -> Iterator[_Ours]:
    """Do as `_ours` does of a robot of one joint, of which nobody knows more than its name."""
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / f"{name}.urdf"
        about = mass * 1e-2  # [kg m²], as far as anybody knows
        urdf.write_text(
            _ARM.format(name=name, kind=kind, axis=axis, mass=mass, about=about), encoding="utf-8"
        )
        yield from _ours(str(urdf), learned)


def _ours(robot: str, learned: Sequence[Recording]) -> Iterator[_Ours]:
    """Give limo's commands, what each has chosen, and what predicts torque (T, n) [N m]."""
    model = RobotModel.load(robot)
    width, _ = fitting_bandwidth(model, learned)
    simulation = identify(model, learned, rows=Rows(width)).simulation
    yield "limo identify", f"{width:g} Hz", lambda one: simulation.predict(one, width)
    best = best_model(simulation, learned, width)
    yield "limo train", f"{width:g} Hz, {best.fitted.record['choice']['chosen']}", best.predict
    physics = JointPhysics(simulation, width).fit(learned)
    yield "limo train --model joint-physics", f"{width:g} Hz", physics.predict
    for kind in _NETWORKS:
        settings = usual_settings("drive", kind)
        network = HybridModel(simulation, settings.following(width)).fit(learned)
        who = f"limo train --model {kind} --features drive"
        yield who, f"{width:g} Hz", network.predict
