"""An arm without a force sensor scans: how hard does the probe press, and within what interval?

    python examples/feel_a_probe.py

The library's way through docs/ultrasound.md, with a simulated iiwa 14 whose joints remember where
they turned over: four motions that touch nothing and one that is pressed with 15 N for three
seconds. Takes two minutes.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

import limo_driver as limo
from limo_driver.physics import ExternalContact

OUT = Path("out/feel_a_probe")
PRESS = ExternalContact(windows=((12.0, 15.0),), wrench=((0.0, 0.0, 15.0, 0.0, 0.0, 0.0),))
IN_95_PERCENT = 1.96


def main() -> None:
    """Record, identify, learn, and feel."""
    arm = limo.Simulation.load(Path(__file__).parent / "iiwa14_hysteretic.yaml")
    pressed = replace(arm, effects=(*arm.effects, PRESS))
    monday, tuesday, thursday, scan = (
        limo.run(
            "mujoco",
            limo.plan("iiwa14", limo.PlanRequest(scaffolds=1), seed=seed),
            simulation=true,
            seed=seed,
            rate=100.0,
        )
        for seed, true in ((1, arm), (2, arm), (4, arm), (5, pressed))
    )
    known = limo.identify("iiwa14", [monday, tuesday]).simulation
    model = limo.train(known, [monday, tuesday])
    free = limo.external_wrench(model, thursday)
    print(f"where nothing touched: {np.median(free.force):.2f} N in the median")
    felt = limo.external_wrench(model, scan, untouched=(0.0, 5.0))
    rows = (felt.time > PRESS.windows[0][0] + 0.5) & (felt.time < PRESS.windows[0][1] - 0.5)
    force, std = felt.value[rows, :3].mean(axis=0), felt.std[rows, :3].mean(axis=0)
    size = np.linalg.norm(force)  # in the axes of the flange
    margin = IN_95_PERCENT * np.linalg.norm(std * force / size)
    print(f"pressed with 15 N: {size:.1f} N, 95 % within {margin:.1f} N")


if __name__ == "__main__":
    main()
