"""Write an estimator as a pair of C files.

The threshold of external torque that gives a stated rate of false alarms.

It counts in standard deviations of the model's error, and is found in one of two ways.

*Of recorded free motion.* Where nothing touches the arm, external torque is error. Each time it
rises above a level u and falls again, its largest value is a peak; peaks further apart than
1/bandwidth are taken for independent. With u so that K peaks lie above it, by b on average, in the
time T, the tail of an exponential distribution gives

    rate of alarms = (K / T) exp(-(k - u) / b)

for each joint, of which it has the n-th part of what is bearable. Errors peak at reversals, far
beyond what normal ones of the same size do, so this is the way to take.

*Without any.* Errors are taken for normal, with a spectrum up to the bandwidth B. They cross k of
their standard deviations upwards at most B exp(-k² / 2) times a second, on both sides:

    rate of alarms = 2 n B exp(-k² / 2)

Source: Coles, "An Introduction to Statistical Modeling of Extreme Values", 2001, ch. 4 and 5
(peaks over thresholds, declustering); Rice, "Mathematical analysis of random noise", Bell System
Technical Journal 24, 1945, sec. 3.3.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.embedded.laws import EffectsCode
from estimators.embedded.learned import LearnedCode, learned
from estimators.embedded.tables import SIDE_BY_SIDE, defines, each_joint, table, tables
from estimators.rigid_body.regressor import RegressorChain
from estimators.stream import Stream
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.physics import Simulation
from limo_driver.physics.effects.body import Payload
from limo_driver.quoting import in_c_comment
from limo_driver.recordings.filters.causal_differentiation import LARGEST
from limo_driver.recordings.filters.standstill import (
    FAR,
    MEMORY,
    NOTHING,
    REACH,
    RestingDifferentiator,
)
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import require_folder, whole

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.base import LiveEstimator
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FALSE_ALARMS: Final = 1.0  # [1/h]
NAME: Final = "limo"
_TORQUES: Final = 5  # of the model that are filtered: its own, three parts of it, and measured
_INCLUDES: Final = f"""#include "{NAME}.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
"""
_SOURCE: Final = Path(__file__).parent / "code"
_HOUR: Final = 3600.0  # [s]
_FEWEST: Final = 20  # peaks that a tail is fitted to
_PART: Final = 0.1  # of all peaks, that are tail


@dataclass(frozen=True, repr=False)
class CodeExport(Displayed):
    """What was written."""

    header: Path
    source: Path
    rate: float  # of the positions [Hz]
    delay: float  # by which the estimate is late [s]
    threshold: tuple[float, ...]  # of external torque, in standard deviations of its error
    measured: bool  # whether that is of free motion, or as if errors were normal
    false_alarms: float  # of the whole arm [1/h]

    def headline(self) -> str:
        """Say where the files are and what they take."""
        return (
            f"{self.header} and {self.source.name}: positions at {self.rate:g} Hz, estimates "
            f"{1e3 * self.delay:g} ms later; {self.false_alarms:g} false alarms of contact an hour"
            + (" by the free motion given" if self.measured else ", if errors were normal")
        )

    def figures(self) -> dict[str, tuple[float, ...]]:
        """Return the threshold of each joint."""
        return {"contact above [standard deviations]": self.threshold}


def export_c(
    model: LiveEstimator | Simulation,
    folder: Path | str,
    rate: float,
    delay: float = 0.1,
    false_alarms: float = FALSE_ALARMS,
    name: str = NAME,
    free: Sequence[Recording] = (),
) -> CodeExport:
    """Write an estimator as C11 that needs nothing but the standard library's mathematics.

    It allocates nothing, reads no file and no locale, and equals `Stream` of the same model.

    Args:
        model: Fitted or loaded; a bare simulation is taken for one that has learned nothing.
        folder: Where `<name>.h` and `<name>.c` are written.
        rate: Of the positions [Hz].
        delay: By which estimates are late [s], see `Stream`.
        false_alarms: Of contact, on the whole arm [1/h], see `threshold`.
        name: Of the files, and with which all names in them begin.
        free: Motion at this rate that nothing touched and the model was not trained on, whose
            errors say where a contact begins; if none is given, errors are taken for normal.

    Returns:
        The files, and what they were made for.

    Raises:
        ConfigError: The name is none in C, the model, an effect of its simulation or its robot has
            no form in C, or a file cannot be written.
        NotFittedError: The model was neither fitted nor loaded.
        ModelStoreError: The model has a memory whose rate this one is no multiple of.
        RecordingError: Free motion has another rate or robot, or is too short.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ConfigError(
            f"{name!r} is no name to begin with in C, expected small letters, digits and _"
        )
    stream = Stream(model, rate, delay)
    estimator = stream.model
    simulation = simulation_of(estimator)
    slides = RegressorChain.of(simulation.body).axis[:, :3].any(axis=1)
    if slides.any():
        joint = simulation.model.joint_names[int(np.argmax(slides))]
        raise ConfigError(f"{joint} slides; only joints that turn have a form in C")
    if free:
        level = measured_threshold(false_alarms, stream, free)
    else:
        level = normal_threshold(false_alarms, estimator.n, estimator.bandwidth)
    code = _Code(
        stream,
        simulation,
        EffectsCode.of(simulation.effects, rate),
        learned(estimator, rate),
        level,
    )
    header, source = Path(folder) / f"{name}.h", Path(folder) / f"{name}.c"
    require_folder(Path(folder), "C code", (header.name, source.name))
    for path, text in ((header, code.header()), (source, code.source())):
        with whole(path) as draft:
            draft.write_text(named(text, name), encoding="utf-8")
    reached = tuple(level.tolist())
    return CodeExport(header, source, rate, stream.delay, reached, bool(free), false_alarms)


def simulation_of(model: LiveEstimator) -> Simulation:
    """Return what an estimator adds to.

    Raises:
        ConfigError: It adds to nothing.
    """
    simulation = getattr(model, "simulation", None)
    if not isinstance(simulation, Simulation):
        raise ConfigError(f"a model of kind {type(model).__name__} has no form in C")
    return simulation


def named(text: str, name: str) -> str:
    """Return code whose names begin with `name` instead of limo."""
    return (
        text.replace("limo_", f"{name}_")
        .replace("LIMO_", f"{name.upper()}_")
        .replace(f'"{NAME}.h"', f'"{name}.h"')
    )


@dataclass(frozen=True)
class _Code:
    """An estimator as text."""

    stream: Stream
    simulation: Simulation
    effects: EffectsCode
    learned: LearnedCode
    threshold: FloatArray  # (n,)

    def header(self) -> str:
        stream, filtering = self.stream, self.stream.differentiator
        sizes = {
            "LIMO_JOINTS": stream.n,
            "LIMO_RATE": float(stream.rate),
            "LIMO_DELAY": float(stream.delay),
            "LIMO_LANES": -(-stream.n // SIDE_BY_SIDE) * SIDE_BY_SIDE,
            "LIMO_TAPS": filtering.taps.shape[1],
            "LIMO_RESTS": MEMORY if isinstance(filtering, RestingDifferentiator) else 0,
            "LIMO_TORQUE_TAPS": stream.smoother.taps.shape[1] if stream.smoother else 1,
            "LIMO_TORQUES": _TORQUES,
            "LIMO_EFFECT_MEMORY": max(len(self.effects.memory), 1),
            "LIMO_JOINT_MEMORY": max(len(self.learned.joints), 1),
            "LIMO_NETWORK_MEMORY": max(self.learned.network, 1),
        }
        robot = in_c_comment(Path(self.simulation.robot).name)
        joints = ", ".join(map(in_c_comment, self.simulation.model.joint_names))
        about = (
            f"/* Joint torque of {robot}, written by limo {version(NAME)}.\n"
            f" * Joints in order: {joints}. SI units. Not to be edited. */\n"
        )
        guard = "#ifndef LIMO_H\n#define LIMO_H\n\n"
        return about + guard + defines(sizes) + "\n" + _read("estimator.h") + "\n#endif\n"

    def source(self) -> str:
        joint_physics = "joint_physics.c" in self.learned.sources
        payloads = [item for item in self.simulation.effects if isinstance(item, Payload)]
        body, n = self.simulation.body, self.stream.n
        filtering, smoother = self.stream.differentiator, self.stream.smoother
        constants: dict[str, int | float] = {
            "N": n,
            "TAPS": filtering.taps.shape[1],
            "FILTERS": filtering.taps.shape[0],
            "POSES": 2 + 2 * n if joint_physics else 2,
            "LONGEST_STEP": float(filtering.longest_step),
            "LARGEST": LARGEST,
            "LEARNS_JOINT_PHYSICS": int(joint_physics),
            "LEARNS_BY_NETWORK": int("network.c" in self.learned.sources),
            "HAS_PAYLOAD": int(bool(payloads)),
            "DISPLACES": int(self.effects.displaces),
        }
        if isinstance(filtering, RestingDifferentiator):
            constants |= {
                "NOTHING": NOTHING,
                "BAND": REACH * filtering.to_noise,
                "FAR_NOISE": FAR**2,
                "NOISE_SAMPLES": float(filtering.remembered),
                "ANCHOR_SAMPLES": float(filtering.anchored),
                "SETTLED_SAMPLES": float(filtering.settled),
            }
        text = "\n".join(
            [
                _INCLUDES,
                defines(constants | self.learned.defines),
                tables(body, payloads),
                table("taps", np.ascontiguousarray(filtering.taps.T)),
                table("torque_taps", smoother.taps[0]) if smoother else "",
                table("contact_above", self.threshold),
                table("effects_at_first", self.effects.memory or (0.0,)),
                table("joints_at_first", self.learned.joints or (0.0,)),
                self.learned.tables,
                _read("body.c"),
                self._acting(),
                *(_read(name) for name in self.learned.sources),
                _read("estimator.c"),
            ]
        )
        return each_joint(body, text)

    def _acting(self) -> str:
        """Return the functions of the effects, and of their laws."""
        laws = re.split(r"/\*: (\w+) \*/\n", _read("laws.c"))[1:]
        needed = [
            text
            for name, text in zip(laws[::2], laws[1::2], strict=True)
            if name in self.effects.functions
        ]
        acts = _function(
            "act",
            "limo_memory *memory, double time, const double q[N], const double v[N], "
            "const double a[N],\n                const double load[N], double other[N], "
            "double friction[N], double displacement[N]",
            ("memory", "time", "q", "v", "a", "load", "other", "friction", "displacement"),
            self.effects.acting,
        )
        senses = _function(
            "sense",
            "limo_memory *memory, double time, double torque[N]",
            ("memory", "time", "torque"),
            self.effects.sensing,
        )
        return "".join([*needed, acts, senses])


def _function(name: str, parameters: str, names: tuple[str, ...], statements: str) -> str:
    unused = "".join(f"    (void){own};\n" for own in names)
    return f"static void {name}({parameters})\n{{\n{unused}{statements}}}\n\n"


def _read(name: str) -> str:
    return (_SOURCE / name).read_text(encoding="utf-8")


def normal_threshold(false_alarms: float, joints: int, bandwidth: float) -> FloatArray:
    """Return how many standard deviations normal errors reach as often, (n,).

    Args:
        false_alarms: Wanted of the whole arm [1/h].
        joints: Number n of joints.
        bandwidth: Of the filter on motion and torque [Hz].

    Raises:
        ConfigError: So many would be no rate of alarms, or more than there are crossings.
    """
    crossings = 2.0 * joints * bandwidth * _HOUR
    if not 0.0 < false_alarms < crossings:
        raise ConfigError(
            f"{false_alarms:g} false alarms an hour, expected above 0 and below {crossings:.3g}, "
            f"which {joints} joints behind {bandwidth:g} Hz give without any threshold"
        )
    return np.full(joints, math.sqrt(2.0 * math.log(crossings / false_alarms)))


def measured_threshold(
    false_alarms: float, stream: Stream, free: Sequence[Recording]
) -> FloatArray:
    """Return how many standard deviations the errors on free motion reach as often, (n,).

    Args:
        false_alarms: Wanted of the whole arm [1/h].
        stream: Of the model.
        free: Motion that nothing touched, and that the model was not trained on.

    Raises:
        ConfigError: The rate of alarms is not possible.
        RecordingError: A recording has another rate, or a joint's errors have too few peaks.
    """
    normal_threshold(false_alarms, stream.n, stream.model.bandwidth)  # refuses an impossible rate
    peaks: list[list[FloatArray]] = [[] for _ in range(stream.n)]
    known = np.zeros(stream.n)
    apart = math.ceil(stream.rate / stream.model.bandwidth)
    for recording in free:
        recording.check_robot(stream.model.simulation.model)  # pyright: ignore[reportAttributeAccessIssue]
        late, _ = stream.advance(
            stream.init(), recording.time, recording.position, recording.torque
        )
        if late.measured is None:
            continue
        usable = ~late.outside
        usable[: 2 * stream.samples] = False  # the filter fills
        size = np.where(usable, np.abs(late.measured - late.torque) / late.std, 0.0)
        known += usable.sum(axis=0) / stream.rate
        for j in range(stream.n):
            peaks[j].append(_peaks(size[:, j], apart))
    found = [np.concatenate(own) for own in peaks]
    for j, own in enumerate(found):
        if own.size < _FEWEST:
            raise RecordingError(
                f"joint {j + 1}: {own.size} peaks of the error where the model is sure, expected "
                f"at least {_FEWEST}; record free motion for longer, like that of the training"
            )
    wanted = false_alarms / _HOUR / stream.n
    return np.array([_level(own, time, wanted) for own, time in zip(found, known, strict=True)])


def _peaks(size: FloatArray, apart: int) -> FloatArray:
    """Return the largest value of each stretch of `apart` samples that is above its neighbours."""
    blocks = np.append(size, np.zeros(-size.size % apart)).reshape(-1, apart).max(axis=1)
    above: NDArray[np.bool_] = blocks > 0.0
    before, after = np.append(0.0, blocks[:-1]), np.append(blocks[1:], 0.0)
    return blocks[above & (blocks >= before) & (blocks > after)]


def _level(peaks: FloatArray, time: float, wanted: float) -> float:
    """Return the level that peaks in so much time [s] exceed at a rate [1/s]."""
    ordered = np.sort(peaks)[::-1]
    tail = max(_FEWEST - 1, math.ceil(_PART * ordered.size))
    u, mean = float(ordered[tail]), float(np.mean(ordered[:tail] - ordered[tail]))
    return u + mean * max(math.log(tail / time / wanted), 0.0)
