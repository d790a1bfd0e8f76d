"""`limo excite --for position-servo`: commands, and what they are played with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from limopa.excitation.servo import ServoExcitation, ServoRequest


def excite_for_servos(
    out: Path,
    robot: str,
    request: ServoRequest,
    seed: int,
    lerobot: Path | None,
    motors: str | None,
    *,
    as_json: bool,
) -> None:
    """Plan commands, write them, and say what is in them.

    Args:
        out: CSV to be written.
        robot: The arm.
        request: What the motion has to be.
        seed: Of every random draw.
        lerobot: Folder for a LeRobotDataset of the same commands.
        motors: Their names there, with commas between; those of the joints if not given.
        as_json: Whether figures are printed as JSON.

    Raises:
        ConfigError: Something cannot be written, or the names are of another number.
        InfeasiblePathError: There is no such motion.
    """
    from limo_driver.app.library.planning import excite_servos
    from limo_driver.model import RobotModel
    from limo_driver.runtime.outputs import page_of, require_file
    from limopa.excitation.servo_page import servo_page

    if out.suffix.lower() != ".csv":
        raise ConfigError("is no CSV; commands for position servos are written as .csv", path=out)
    page = page_of(out)
    for path in (out, page):
        if path is not None:
            require_file(path)
    model = RobotModel.load(robot)
    names = tuple(motors.split(",")) if motors else model.joint_names
    if len(names) != model.n:
        raise ConfigError(f"--motors names {len(names)}, but {model.name} has {model.n} joints")
    found = excite_servos(model, request, seed=seed)
    found.save(out)
    if lerobot is not None:
        found.save_for_lerobot(lerobot, names)
    if page is not None:
        servo_page(found, model, out.name, robot, names).save(page)
    _report(found, as_json=as_json)


def _report(found: ServoExcitation, *, as_json: bool) -> None:
    from limo_driver.app.console.terminal import terminal

    if as_json:
        import json
        import sys

        figures = {name: list(values) for name, values in found.figures().items()}
        told = {
            "robot": found.robot,
            "seed": found.seed,
            "duration": found.duration,
            "rate": found.request.rate,
            "samples": len(found.time),
            "repetitions": [[rows.start, rows.stop] for rows in found.repetitions],
            **figures,
        }
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
        return
    console = terminal(soft_wrap=True)
    console.print(str(found))
    console.print("lead the arm slowly to the first pose before the first command is sent")
    if found.unchecked_pairs:
        pairs = ", ".join(" and ".join(pair) for pair in found.unchecked_pairs)
        console.print(f"not checked against each other, since they always touch: {pairs}")
