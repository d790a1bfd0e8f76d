"""Find the load on a real UR10e: identify it unloaded, then diagnose a loaded run.

The folder with the recordings (ur10e/*.parquet and ur10e/ur10e.urdf) is named by LIMO_DATA. The
torques there are motor currents times gains from the literature, good to about 10 %, and a mass is
found in the unit that the gains make of it: the load weighs 2.805 kg, its interval below is that of
the fit alone. A scale put on the known load would tell the gains apart from the mass.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

DATA = Path(os.environ.get("LIMO_DATA", "../shared/data")) / "ur10e"
OUT = Path("out/diagnose_real")
GAINS = 0.1  # relative uncertainty of the current gains


def limo(*arguments: object) -> None:
    """Run a command as a shell would."""
    print("$ limo", *arguments, flush=True)
    main = "from limo_driver.cli import main; main()"
    subprocess.run([sys.executable, "-c", main, *map(str, arguments)], check=True)


def main() -> None:
    """Identify, diagnose, and say what was found beside what is known."""
    if not DATA.is_dir():
        sys.exit(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    OUT.mkdir(parents=True, exist_ok=True)
    sim, found = OUT / "sim.yaml", OUT / "diagnosis"
    unloaded, loaded = DATA / "unloaded_14harm.parquet", DATA / "loaded_14harm.parquet"
    band = ("--bandwidth", 8)
    limo("identify", unloaded, "--robot", DATA / "ur10e.urdf", "--moving-only", *band, "--out", sim)
    limo("diagnose", loaded, "--sim", sim, *band, "--out", found)

    verdict = json.loads((found / "verdict.json").read_text())
    for item in verdict["findings"]:
        if item["effect"] == "payload":
            mass = item["parameters"]["mass"]
            value, (low, high) = mass["value"], mass["ci95"]
            print(
                f"payload: {value:.2f} kg (95 % of the fit: {low:.2f} to {high:.2f}; known 2.805)"
            )
            print(
                f"with gains good to 10 %: {value * (1 - GAINS):.2f} to {value * (1 + GAINS):.2f}"
            )
    print(f"verdict: {verdict['verdict']}; open {found}/report.html")


if __name__ == "__main__":
    main()
