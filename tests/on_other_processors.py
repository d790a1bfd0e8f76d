"""Run the tests that hang on arithmetic as other processors would: `make test-numerics`.

    python tests/on_other_processors.py [ARGUMENT OF PYTEST ...]

OpenBLAS picks its kernels by the processor, numba compiles for it, and numpy chooses its loops by
it: sums are taken in another order, products fused or not, exponentials rounded otherwise. All of
it can be asked for by environment variables, as far as the processor can run it: three kernels
where it has AVX2, and beside the oldest of them numba, numpy and torch as on an x86-64 of 2009.
numpy and scipy bring an OpenBLAS each, and both obey; torch brings kernels of its own, which do
not, but do without AVX2 where they are told to. Machine code that numba keeps, it keeps by
processor.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]

# What hangs on arithmetic: of that what is not slow.
TESTS = (
    "tests/estimators/regression",
    "tests/estimators/rigid_body",
    "tests/estimators/joint_physics",
    "tests/estimators/diagnosis/from_torque/hypotheses",
    "tests/estimators/diagnosis/from_torque/fitting/test_bodies.py",
    "tests/estimators/diagnosis/from_torque/fitting/test_linearised.py",
    "tests/limo_driver/test_signatures.py",
    "tests/limopa/test_same_plan.py",
    "tests/regression/test_frozen_outputs.py",
)
SELECTED = ("-m", "not slow", "-k", "not network")

KERNELS = ("Prescott", "Nehalem", "Sandybridge", "Haswell", "Zen", "SkylakeX")  # the oldest first
FEWEST = 3  # that are others, where the processor has AVX2

_PROBE = """
import json, numpy, scipy.linalg
from numpy._core import _multiarray_umath as loops
from threadpoolctl import threadpool_info
a = numpy.random.default_rng(0).normal(size=(300, 300))
b = a @ a.T
numpy.linalg.eigvalsh(b), scipy.linalg.cholesky(b), scipy.linalg.solve(b, a)
libraries = {
    next((part for part in ("numpy", "scipy") if f"{part}.libs" in item["filepath"]), "BLAS"):
    f"{item['internal_api']} {item.get('architecture', '')}".strip()
    for item in threadpool_info() if item["user_api"] == "blas"
}
newer = [name for name in loops.__cpu_dispatch__ if loops.__cpu_features__.get(name)]
print(json.dumps({"libraries": libraries, "newer": newer}))
"""


@dataclass(frozen=True)
class Kernel:
    """A kernel of BLAS that runs on this processor."""

    name: str  # as it is asked for
    libraries: dict[str, str]  # what each library then says that it has
    newer: tuple[str, ...]  # loops of numpy that an old processor has not

    def settings(self, *, old: bool) -> dict[str, str]:
        """Return the environment that asks for it, and for an old processor all around."""
        asked = {"OPENBLAS_CORETYPE": self.name, "OPENBLAS_NUM_THREADS": "1"}
        if not old:
            return asked
        return asked | {
            "NUMBA_CPU_NAME": "generic",
            "NPY_DISABLE_CPU_FEATURES": " ".join(self.newer),
            "ATEN_CPU_CAPABILITY": "default",
        }

    def __str__(self) -> str:
        used = ", ".join(f"{name} has {own}" for name, own in sorted(self.libraries.items()))
        return f"{self.name}: {used or 'no BLAS that tells of itself'}"


def probed(name: str) -> Kernel | None:
    """Return a kernel, or None where the processor ends a program that uses it."""
    settings = os.environ | {"OPENBLAS_CORETYPE": name}
    command = [sys.executable, "-c", _PROBE]
    done = subprocess.run(command, env=settings, capture_output=True, text=True, check=False)
    if done.returncode:
        return None
    found = json.loads(done.stdout)
    return Kernel(name, found["libraries"], tuple(found["newer"]))


def kernels() -> list[Kernel]:
    """Return those that run here, one of each that is another, the oldest first."""
    found: dict[str, Kernel] = {}
    for kernel in filter(None, map(probed, KERNELS)):
        found.setdefault(str(sorted(kernel.libraries.items())), kernel)
    return list(found.values())


def passes(kernel: Kernel, arguments: list[str], *, old: bool) -> bool:
    """Run the tests with a kernel, and say whether they pass."""
    around = ", numba, numpy and torch as on an old processor" if old else ""
    print(f"\n== {kernel}{around}", flush=True)
    begun = time.monotonic()
    command = [sys.executable, "-m", "pytest", "--quiet", *SELECTED, *arguments, *TESTS]
    settings = os.environ | kernel.settings(old=old)
    done = subprocess.run(command, env=settings, cwd=ROOT, check=False)
    print(f"== {kernel.name}: {time.monotonic() - begun:.0f} s", flush=True)
    return done.returncode == 0


def main() -> int:
    """Run the oldest kernel with all around it old, and the two newest ones."""
    found = kernels()
    has_avx2 = any("Haswell" in own for kernel in found for own in kernel.libraries.values())
    if has_avx2 and len(found) < FEWEST:
        print(f"only {len(found)} kernels of BLAS run here, expected {FEWEST}:", *found, sep="\n")
        return 1
    if not has_avx2:
        print(f"no x86-64 with AVX2: {len(found)} kernels of BLAS are all that can be run")
    results = [passes(found[0], sys.argv[1:], old=True)]
    results += [passes(kernel, sys.argv[1:], old=False) for kernel in found[1:][-2:]]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
