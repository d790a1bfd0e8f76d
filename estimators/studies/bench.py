"""Benchmarks of others on limo as anybody would call it, on files that a user has.

Each is learned from the files that its authors learn from, and judged on theirs by their measure.
Next to limo's figure stands theirs: of EMPS their own procedure, run here; of NNFM the
predictions that the authors publish in the same file.

Source: Janot, Gautier and Brunot, "Data set and reference models of EMPS", Workshop on Nonlinear
System Identification Benchmarks 2019 (DATA_EMPS.mat, DATA_EMPS_PULSES.mat); Long et al., "NNFM: A
novel neural network modeling approach for robot flexible joints friction", whose repository has
case1_high.csv to case4_slow.csv.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.joint_physics import JointPhysics
from estimators.rigid_body import Rows, identify
from estimators.rigid_body.best_bandwidth import fitting_bandwidth
from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

EMPS: Final = ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")
SPEEDS: Final = ("high", "middle", "slow")
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


def bench(folder: Path, tell: Callable[[str], None] = lambda _: None) -> tuple[BenchRow, ...]:
    """Compute all benchmarks whose files are in a folder.

    Args:
        folder: With the authors' files, under their names, in it or in folders below.
        tell: Told what is computed next.

    Raises:
        RecordingError: No benchmark's files are there, or one is not as its authors made it.
    """
    files = {path.name: path for path in sorted(folder.rglob("*")) if path.is_file()}
    rows: list[BenchRow] = []
    if all(name in files for name in EMPS):
        tell("EMPS")
        rows += _emps(*(files[name] for name in EMPS))
    for case in range(1, 5):
        names = [f"case{case}_{speed}.csv" for speed in SPEEDS]
        if all(name in files for name in names):
            tell(f"NNFM, case {case}")
            rows += _friction(case, [files[name] for name in names])
    if not rows:
        raise RecordingError(
            f"has the files of no benchmark, expected {' and '.join(EMPS)}, or case1_high.csv, "
            "case1_middle.csv and case1_slow.csv (likewise cases 2 to 4)",
            path=folder,
        )
    return tuple(rows)


def _emps(learned: Path, test: Path) -> Iterator[BenchRow]:
    """Give the relative error of the force of the slide on the file with pulses."""
    (train, training), (judged, tested) = (_slide(path) for path in (learned, test))
    width, simulation = _identified("slide", "prismatic", "1 0 0", 100.0, train)
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
    yield BenchRow(
        *of, "limo identify", error(simulation.predict(judged, width)[:, 0]), f"{width:g} Hz"
    )
    model = JointPhysics(simulation, width).fit([train])
    yield BenchRow(
        *of, "limo train --model joint-physics", error(model.predict(judged)[:, 0]), f"{width:g} Hz"
    )


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

    try:
        values: dict[str, Any] = loadmat(path)
        time, position, force = (values[name].ravel() for name in ("t", "qm", "vir"))
        force = force * float(values["gtau"].ravel()[0])
    except (KeyError, ValueError, NotImplementedError, OSError) as error:
        raise RecordingError(
            f"is no file of the EMPS, which has t, qm, vir and gtau: {error}", path=path
        ) from None
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
        width, simulation = _identified(f"joint{joint}", "revolute", "0 0 1", 1e-3, *others)
        model = JointPhysics(simulation, width).fit(others)
        both = {
            "limo identify": simulation.predict(judged, width),
            "limo train --model joint-physics": model.predict(judged),
        }
        for name, torque in both.items():
            source = f"learned from the other speeds, {width:g} Hz"
            yield BenchRow(*of, name, error(torque[:, 0]), source)


def _friction_of(path: Path) -> tuple[Recording, dict[str, FloatArray], str]:
    """Read motion and friction of a joint, the peers' predictions, and the joint's number."""
    from pyarrow import ArrowInvalid
    from pyarrow.csv import read_csv

    try:
        table = read_csv(path)
        joint = table.column_names[1].removeprefix("q")
        named = ("time", f"q{joint}", f"q{joint}_tau_J_compensate")
        time, position, torque = (table[name].to_numpy() for name in named)
        peers = {name: table[name].to_numpy() for name in _PEERS}
    except (KeyError, ValueError, IndexError, ArrowInvalid) as error:
        raise RecordingError(
            f"is no comparison of NNFM, which has time, q, friction and {', '.join(_PEERS)}: "
            f"{error}",
            path=path,
        ) from None
    recording = Recording.from_arrays(time, position[:, None], torque[:, None])
    kept = slice(None) if recording.rows is None else recording.rows
    return recording, {name: values[kept] for name, values in peers.items()}, joint


def _identified(
    name: str, kind: str, axis: str, mass: float, *recordings: Recording
) -> tuple[float, Simulation]:
    """Identify one joint as `limo identify` does; return the bandwidth [Hz] and the simulation."""
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / f"{name}.urdf"
        about = mass * 1e-2  # [kg m²], as far as anybody knows
        urdf.write_text(
            _ARM.format(name=name, kind=kind, axis=axis, mass=mass, about=about), encoding="utf-8"
        )
        model = RobotModel.load(urdf)
        width, _ = fitting_bandwidth(model, recordings)
        return width, identify(model, recordings, rows=Rows(width)).simulation
