"""Find the load on a real UR10e: identify it unloaded, then diagnose a loaded run.

The folder with the recordings (ur10e/*.parquet and ur10e/ur10e.urdf) is named by LIMO_DATA. The
torques there are motor currents times gains from the literature, good to about 10 %, and a mass is
found in the unit that the gains make of it: the load weighs 2.805 kg, its interval below is that of
the fit alone. A scale put on the known load would tell the gains apart from the mass.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import limo_driver as limo
from estimators.rigid_body import Rows

DATA = Path(os.environ.get("LIMO_DATA", "../shared/data")) / "ur10e"
OUT = Path("out/diagnose_real")
BANDWIDTH = 8.0  # [Hz]
GAINS = 0.1  # relative uncertainty of the current gains


def main() -> None:
    """Identify, diagnose, and say what was found beside what is known."""
    if not DATA.is_dir():
        sys.exit(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    unloaded = limo.Recording.load(DATA / "unloaded_14harm.parquet")
    loaded = limo.Recording.load(DATA / "loaded_14harm.parquet")
    rows = Rows(BANDWIDTH, moving_only=True)  # at rest, currents say little of the torque
    believed = limo.identify(str(DATA / "ur10e.urdf"), [unloaded], rows=rows).simulation
    found = limo.diagnose(believed, [loaded], bandwidth=BANDWIDTH)
    found.save(OUT)
    print(found)
    for item in found.findings:
        if item.effect == "payload":
            mass = item.parameters["mass"]
            value, (low, high) = mass.value, mass.ci95
            print(
                f"payload: {value:.2f} kg (95 % of the fit: {low:.2f} to {high:.2f}; known 2.805)"
            )
            print(
                f"with gains good to 10 %: {value * (1 - GAINS):.2f} to {value * (1 + GAINS):.2f}"
            )
    print(f"open {OUT}/report.html")


if __name__ == "__main__":
    main()
