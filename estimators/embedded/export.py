"""Write an estimator as a pair of C files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from estimators.base import LiveEstimator
from estimators.embedded.contact import (
    FALSE_ALARMS,
    NO_CONTACT,
    SLOW,
    TURNED,
    ContactThresholds,
    measured_contact,
)
from estimators.embedded.laws import EffectsCode
from estimators.embedded.tables import (
    SIDE_BY_SIDE,
    LearnedCode,
    defines,
    each_joint,
    learned,
    table,
    tables,
)
from estimators.rigid_body.regressor import RegressorChain
from estimators.stream import Stream
from limo_driver.errors import ConfigError
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
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.display import Displayed
from limo_driver.runtime.outputs import require_folder, whole

NAME: Final = "limo"
_TORQUES: Final = 5  # of the model that are filtered: its own, three parts of it, and measured
_INCLUDES: Final = f"""#include "{NAME}.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
"""
_SOURCE: Final = Path(__file__).parent / "code"


@dataclass(frozen=True, repr=False)
class CodeExport(Displayed):
    """What was written."""

    header: Path
    source: Path
    rate: float  # of the positions [Hz]
    delay: float  # by which the estimate is late [s]
    contact: ContactThresholds | None = None  # where free motion was given

    def headline(self) -> str:
        """Say where the files are and what they take."""
        return (
            f"{self.header} and {self.source.name}: positions at {self.rate:g} Hz, estimates "
            f"{1e3 * self.delay:g} ms later; {self.contact or NO_CONTACT}"
        )

    def figures(self) -> dict[str, Sequence[float]]:
        """Return the threshold of each joint, and the error that it counts in."""
        if self.contact is None:
            return {}
        level, error = self.contact.level, self.contact.error
        found = {"joint": range(1, level.size + 1), "contact above [deviations]": level.tolist()}
        return found | {"contact above [N m]": (level * error).tolist()}


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
        false_alarms: Of contact, on the whole arm [1/h].
        name: Of the files, and with which all names in them begin.
        free: Motion at this rate that nothing touched and the model was not trained on, whose
            errors say where a contact begins; if none is given, the code has no contact.

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
    code = _Code.of(stream)
    if not free and false_alarms != FALSE_ALARMS:
        raise ConfigError(f"{false_alarms:g} false alarms an hour: {NO_CONTACT}")
    contact = measured_contact(false_alarms, stream, code.simulation, free) if free else None
    code = replace(code, contact=contact)
    header, source = Path(folder) / f"{name}.h", Path(folder) / f"{name}.c"
    require_folder(Path(folder), "C code", (header.name, source.name))
    for path, text in ((header, code.header()), (source, code.source())):
        with whole(path) as draft:
            draft.write_text(named(text, name), encoding="utf-8")
    return CodeExport(header, source, rate, stream.delay, contact)


def source_of(stream: Stream) -> str:
    """Return a stream as one file of C11, with `limo_advance` for programs without its header.

    Raises:
        ConfigError: The model, an effect of its simulation or its robot has no form in C.
    """
    code = _Code.of(stream)
    include = f'#include "{NAME}.h"\n'
    return code.source().replace(include, code.header(), 1) + _read("stream.c")


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
    contact: ContactThresholds | None = None

    @classmethod
    def of(cls, stream: Stream) -> _Code:
        simulation = simulation_of(stream.model)
        slides = RegressorChain.of(simulation.body).axis[:, :3].any(axis=1)
        if slides.any():
            joint = simulation.model.joint_names[int(np.argmax(slides))]
            raise ConfigError(f"{joint} slides; only joints that turn have a form in C")
        effects = EffectsCode.of(simulation.effects, stream.rate)
        return cls(stream, simulation, effects, learned(stream.model, stream.rate))

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
            "LIMO_CONTACT": int(self.contact is not None),
        }
        robot = in_c_comment(Path(self.simulation.robot).name)
        joints = ", ".join(map(in_c_comment, self.simulation.model.joint_names))
        about = (
            f"/* Joint torque of {robot}, written by limo {version(NAME)}.\n"
            f" * Joints in order: {joints}. SI units. Not to be edited.\n"
            f" * {self.contact or in_c_comment(NO_CONTACT)}.{self._thresholds()} */\n"
        )
        guard = "#ifndef LIMO_H\n#define LIMO_H\n\n"
        return about + guard + defines(sizes) + "\n" + _read("estimator.h") + "\n#endif\n"

    def _thresholds(self) -> str:
        if self.contact is None:
            return ""
        joints = enumerate(map(in_c_comment, self.simulation.model.joint_names))
        return "".join(f"\n *   {name}: above {self.contact.of_joint(j)}" for j, name in joints)

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
            "LONGEST_GAP": float(filtering.longest_gap),
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
                self._contact(),
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

    def _contact(self) -> str:
        if self.contact is None:
            return ""
        contact, unlike = self.contact, 2 * self.stream.samples
        return (
            table("free_error", contact.error)
            + table("contact_above", contact.level)
            + table("free_least", contact.covered[0])
            + table("free_most", contact.covered[1])
            + table("free_speeds", contact.speeds.astype(float))
            + defines({"TURNED": TURNED, "SLOW": SLOW, "UNLIKE_SAMPLES": unlike})
        )

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
