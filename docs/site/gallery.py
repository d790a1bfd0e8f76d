"""Run the examples for the site: what each prints and draws goes to out/gallery/NAME/.

    python docs/site/gallery.py            # those that take seconds, and the sample report
    python docs/site/gallery.py --all      # those that take minutes, too

One that ran already and has not changed since is not run again. Where one fails, so does this.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "gallery"
QUICK = (
    "predict_torque",
    "creep_and_reverse",
    "diagnose_simulated",
    "your_csv",
    "your_mjcf",
    "your_bag",
)
SLOW = ("fri_controller", "can_arm", "live_service")  # in real time, or long


def ran(name: str) -> bool:
    """Say whether an example ran since it was written."""
    printed = OUT / name / "printed.txt"
    example = ROOT / "examples" / f"{name}.py"
    return printed.exists() and printed.stat().st_mtime > example.stat().st_mtime


def run(name: str) -> int:
    """Run an example in a folder of its own, and keep what it printed and drew."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "examples").symlink_to(ROOT / "examples")
        done = subprocess.run(  # noqa: S603  # an example of this project
            [sys.executable, str(ROOT / "examples" / f"{name}.py")],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            sys.stderr.write(f"{name}: exit status {done.returncode}\n{done.stderr}")
            return done.returncode
        kept = OUT / name
        shutil.rmtree(kept, ignore_errors=True)
        kept.mkdir(parents=True)
        for path in Path(folder).glob("out/**/*"):
            if path.suffix in {".png", ".html"}:
                shutil.copy(path, kept / path.name)
        (kept / "printed.txt").write_text(done.stdout, encoding="utf-8")
    return 0


def main() -> None:
    """Run what is asked for; the exit status says whether all went well."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="also what takes minutes")
    names = (*QUICK, *SLOW) if parser.parse_args().all else QUICK
    sys.exit(max(run(name) for name in names if not ran(name)) if not all(map(ran, names)) else 0)


if __name__ == "__main__":
    main()
