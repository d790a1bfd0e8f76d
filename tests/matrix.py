"""Run tests in other environments than that of the checkout: `make test-matrix`.

    python tests/matrix.py [ROW ...]     # all rows of `ROWS`, or those that are named

A row is a Python and packages; each gets an environment of its own below `out/matrix`, which is
kept. One without a Python of its own has this environment under it, and in it no more than its
packages; where none of its Pythons is installed, a line says that it was skipped. A row that has
passed is not run again, as long as no file of this checkout changes: what was interrupted is called
again and goes on.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
LINTERS: Final = ("import-linter", "pre-commit", "pyright", "ruff")
KEPT: Final = ROOT / "out" / "matrix"
WITH_MUJOCO: Final = (
    "tests/limo_driver/exports",
    "tests/limo_driver/model/descriptions",
    "tests/limo_driver/runtime/test_installed_mujoco.py",
    "tests/backends/mujoco_sim",
)


@dataclass(frozen=True)
class Row:
    """An environment, and what is run in it."""

    packages: tuple[str, ...]  # requirements beside those of pyproject, as pip has them
    tests: tuple[str, ...]
    pythons: tuple[str, ...] = ()  # commands, of which the first that is there; none for this one
    pinned: bool = True  # whether other packages of such a Python are as `constraints.txt` has them


def tools() -> tuple[str, ...]:
    """Return what tests need, without what lints, which wants newer packages than limo does."""
    return tuple(x for x in PROJECT["optional-dependencies"]["dev"] if not x.startswith(LINTERS))


def lowest() -> tuple[str, ...]:
    """Return the oldest releases of what limo needs that its bounds allow."""
    needed = PROJECT["dependencies"]
    bounds = (re.match(r"([\w-]+(?:\[\w+\])?)>=([\d.]+)", x) for x in needed)
    return tuple(f"{bound[1]}=={bound[2]}.*" for bound in bounds if bound)


# The rows of other Pythons take several GB each: from PyPI comes the build of torch for GPUs.
# The oldest typer makes newer releases of click warn, and the oldest protobuf does not read what
# newer grpcio-tools generate.
ROWS: Final = {
    "mujoco-3.12": Row(("mujoco==3.12.*",), WITH_MUJOCO),
    "mujoco-3": Row(("mujoco>=3.12,<4",), WITH_MUJOCO),
    "mujoco-4": Row((), WITH_MUJOCO),  # the pinned one
    "lowest": Row(
        (*lowest(), "click<8.2", "grpcio-tools<1.66"), ("tests",), ("python3.11",), pinned=False
    ),
    "newest": Row((), ("tests",), ("python3.14", "python3.13"), pinned=False),
}


def version() -> str:
    """Return a digest of all files of this checkout but those that git ignores."""
    sys.path.insert(0, str(ROOT / "tests" / "lanes"))
    from run import version as digest

    return digest()


def python_of(row: Row) -> str:
    """Return the Python of a row; empty where there is none, but perhaps a shim without one."""
    for command in row.pythons or (sys.executable,):
        found = shutil.which(command)
        if found and not subprocess.run([found, "-V"], capture_output=True, check=False).returncode:
            return found
    return ""


def environment(name: str, row: Row) -> Path:
    """Return the Python of a row's environment, which is made if it is not whole."""
    if not row.pythons and not row.packages:
        return Path(sys.executable)
    folder, made = KEPT / name, KEPT / name / "made"
    python = folder / "bin" / "python"
    under, inputs = python_of(row), _inputs(row)
    if made.is_file() and made.read_text("utf-8") == inputs:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([under, "-m", "venv", str(folder)], check=True)
    pip = [str(python), "-m", "pip", "install", "--quiet"]
    if row.pythons:
        others = KEPT / f"{name}.txt"  # constraints but those of packages that the row chooses
        lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines() if row.pinned else []
        others.write_text("\n".join(x for x in lines if not _is_chosen(x, row)), "utf-8")
        subprocess.run([*pip, "uv"], check=True)  # pip tries releases for a quarter of an hour
        pip = [pip[0], "-m", "uv", "pip", "install", "--quiet", "--python", pip[0]]
        pip += ["--constraint", str(others), "--editable", ".", *tools()]
    else:
        own, here = (_site_packages(each) for each in (python, Path(sys.executable)))
        (own / "under.pth").write_text(f"{here}\nimport site; site.addsitedir({str(here)!r})\n")
        pip += ["--ignore-installed", "--no-deps"]
    subprocess.run([*pip, *row.packages], cwd=ROOT, check=True)
    made.write_text(inputs, "utf-8")
    return python


def _site_packages(python: Path) -> Path:
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    found = subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=True)
    return Path(found.stdout.strip())


def _inputs(row: Row) -> str:
    """Return all that an environment hangs on."""
    files = ((ROOT / name).read_text("utf-8") for name in ("pyproject.toml", "constraints.txt"))
    return "\n".join((repr(row), python_of(row), *files))


def _is_chosen(line: str, row: Row) -> bool:
    """Say whether a constraint is of a package that a row chooses, or of a part of it."""
    chosen = (package.rstrip("0123456789.,*<>=") for package in row.packages)
    return any(line.startswith((f"{name}==", f"{name}-")) for name in chosen)


def passes(name: str, row: Row) -> bool:
    """Run the tests of a row, and say whether they pass."""
    begun = time.monotonic()
    python = environment(name, row)
    command = [str(python), "-m", "pytest", "--quiet", "-m", "not slow", *row.tests]
    done = subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    seconds, said = (
        time.monotonic() - begun,
        subprocess.check_output([str(python), "-V"], text=True),
    )
    print(f"== {name}, {said.strip()}: {'passed' if done else 'FAILED'}, {seconds:.0f} s")
    return done


def main() -> int:
    """Run the rows that have not passed with these files."""
    names = sys.argv[1:] or list(ROWS)
    if unknown := set(names) - ROWS.keys():
        sys.exit(f"no row {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}")
    KEPT.mkdir(parents=True, exist_ok=True)
    now, failed, skipped = version(), list[str](), list[str]()
    for name in names:
        passed = KEPT / f"{name}.passed"
        if passed.is_file() and passed.read_text("utf-8") == now:
            print(f"== {name}: has passed with these files already")
        elif not python_of(ROWS[name]):
            skipped.append(name)
            print(f"== {name}: skipped, there is no {' nor '.join(ROWS[name].pythons)} here")
        elif passes(name, ROWS[name]):
            passed.write_text(now, "utf-8")
        else:
            failed.append(name)
    passed = len(names) - len(failed) - len(skipped)
    print(f"{passed} of {len(names)} rows passed; failed: {failed}; skipped: {skipped}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
