"""An exported model, compiled with sanitizers, beside the stream that it stands for."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.embedded.export import export_c

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, Motion

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror", "-O1")
LINES = "-g1"  # for what a sanitizer finds; where values are, too, takes ten times as long with one
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_FIELDS = (
    "torque",
    "simulation",
    "learned",
    "deviation",
    "gravity",
    "payload",
    "friction",
    "measured",
    "external",
    "threshold",
    "outside",
    "contact",
    "known",
)


@dataclass(frozen=True)
class CEstimates:
    """What the code said of T positions."""

    status: FloatArray  # (T,)
    time: FloatArray  # (T,) [s]
    filled: FloatArray  # (T,)
    values: dict[str, FloatArray]  # (T, n) each

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[name]


@dataclass(frozen=True)
class CModel:
    """A compiled model."""

    program: Path
    n: int

    @classmethod
    def of(
        cls, model: Any, folder: Path, rate: float, compiler: str = "gcc", **options: Any
    ) -> CModel:
        """Export and compile a model."""
        export_c(model, folder, rate, **options)
        program, driver = folder / f"model_{compiler}", Path(__file__).with_name("driver.c")
        sources = [str(driver), str(folder / "limo.c"), "-I", str(folder)]
        command = [compiler, *STRICT, LINES, *SANITIZERS, *sources, "-o", str(program), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        simulation = getattr(model, "simulation", model)
        return cls(program, simulation.model.n)

    def stream(
        self, time: FloatArray, position: FloatArray, torque: FloatArray | None = None
    ) -> CEstimates:
        """Give it positions, and torques where there are any."""
        mode, more = ("position", []) if torque is None else ("torque", [torque])
        return self._run(mode, [time[:, None], position, *more])

    def along(self, motion: Motion) -> CEstimates:
        """Give it a motion with its derivatives."""
        parts = [motion.time[:, None], motion.position, motion.velocity, motion.acceleration]
        return self._run("motion", parts)

    def _run(self, mode: str, parts: list[FloatArray]) -> CEstimates:
        rows = np.ascontiguousarray(np.concatenate(parts, axis=1))
        done = subprocess.run(
            [self.program, mode], input=rows.tobytes(), capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr.decode()
        found = np.frombuffer(done.stdout).reshape(len(rows), 3 + len(_FIELDS) * self.n)
        values = np.split(found[:, 3:], len(_FIELDS), axis=1)
        return CEstimates(*found[:, :3].T, dict(zip(_FIELDS, values, strict=True)))


def worst(found: FloatArray, expected: FloatArray) -> float:
    """Return the largest difference beside the largest value expected."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())
