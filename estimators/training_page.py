"""What a training shows: its page, and the card of the model in its folder."""

from __future__ import annotations

from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, BEFORE, curve, joint_errors, layout
from limo_driver.pages.markup import columns, header, listed, next_steps, paragraph, section
from limo_driver.quoting import in_markdown
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.residual_model import ResidualModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

PAGE: Final = "report.html"
CARD: Final = "card.md"
_UNSTATED: Final = "not stated"
_LEAST: Final = 1e-12  # [N m] of an error that others are compared with
_ERRORS: Final = (
    "RMSE on motion held out from what was learned there. A joint of which nothing is confirmed "
    "stays as the simulation has it."
)
_TRIED: Final = (
    "Each candidate learned from the rest of the motion and predicted what it did not see: the "
    "part of the simulation's error that is left, 1 where a joint stays as the simulation has it, "
    "and the part of the rows within the 95 % interval."
)
_CURVES: Final = (
    "Mean square error of the normalised residual. Grey: what was trained on. Blue: blocks held "
    "out, which choose the weights that are kept."
)


def save_training(
    model: ResidualModel[Any], recordings: Sequence[Recording], folder: Path
) -> tuple[Path, Path]:
    """Write page and card into the folder of a model; return where they are.

    Args:
        model: Fitted, and saved there.
        recordings: That it learned from.
        folder: Of the model.

    Raises:
        ConfigError: A file cannot be written.
    """
    page, card = folder / PAGE, folder / CARD
    training_page(model, recordings).save(page)
    with whole(card) as draft:
        draft.write_text(model_card(model, recordings), encoding="utf-8")
    return page, card


def training_page(model: ResidualModel[Any], recordings: Sequence[Recording]) -> Page:
    """Return the page of a training.

    Args:
        model: Fitted.
        recordings: That it learned from.
    """
    record, charts = model.fitted.record, Charts()
    names = model.simulation.model.joint_names
    errors = held_out_errors(record)
    unit = unit_of("N m", model.simulation.model.sliding)
    title = (
        f"{model.name} of {PurePath(model.simulation.model.name).stem}: {_headline(errors, names)}"
    )
    source = (
        f"{len(recordings)} recording{'s' * (len(recordings) > 1)}, "
        f"{sum(map(len, recordings))} samples, behind a zero-phase filter of "
        f"{model.bandwidth:g} Hz."
    )
    drawn = _errors(errors, names, unit, charts) if errors else ""
    body = (
        header(f"Training of {model.name}", title, source)
        + section("Error of each joint", drawn, "errors", _ERRORS)
        + section("What was tried", _tried(record.get("choice"), names), "tried", _TRIED)
        + section("Training", _curves(record.get("epochs", ()), charts), "curves", _CURVES)
        + section("What it learned from", columns(_data(recordings)), "data")
        + section("Range of the motion", columns(_ranges(model, recordings)), "range")
        + section("Limits", listed(limits(model)), "limits")
        + next_steps(
            [
                (
                    "See how good it is on motion that it did not learn from, and what changed.",
                    "limo evaluate OTHER_RECORDING --model MODEL_FOLDER --out evaluation/",
                ),
                ("Estimate torque live.", "limo serve --arm NAME --model MODEL_FOLDER"),
            ]
        )
    )
    return Page(title, body, charts, sliding=model.simulation.model.sliding)


def model_card(model: ResidualModel[Any], recordings: Sequence[Recording]) -> str:
    """Return the card of a model, Markdown below a head of YAML.

    Args:
        model: Fitted.
        recordings: That it learned from.
    """
    robot, record = model.simulation.model, model.fitted.record
    errors = held_out_errors(record)
    cells = zip(*_data(recordings).values(), strict=True)
    data = [" | ".join(in_markdown(str(value)) for value in row) for row in cells]
    rows = [
        f"| {in_markdown(name)} | {before:.3g} | {after:.3g} |"
        for name, before, after in zip(robot.joint_names, *errors, strict=True)
    ] if errors else []  # fmt: skip
    unit = unit_of("N m", robot.sliding)
    choice = record.get("choice", {}).get("chosen")
    lines = [
        "---",
        f"licence: {_UNSTATED}",
        f"robot: {PurePath(robot.name).stem}",
        f"estimator: {model.name}",
        f"bandwidth: {model.bandwidth:g}  # Hz",
        "---",
        f"# {model.name} of {PurePath(robot.name).stem}",
        f"Joint torque from joint motion, of {robot.n} joints: a simulation and what it leaves, "
        f"learned{f' by {choice}, chosen on motion held out' if choice else ''}.",
        "",
        "## Data",
        f"| {' | '.join(_data(recordings))} |",
        f"|{'---|' * len(_data(recordings))}",
        *(f"| {row} |" for row in data),
        "",
        "Licence of the data: not stated.",
        "",
        "## Limits",
        *(f"- {line}" for line in limits(model)),
    ]
    if rows:
        lines += ["", f"## Error on motion held out, RMSE [{unit}]"]
        lines += ["| joint | simulation | model |", "|---|---|---|", *rows]
    return "\n".join(lines) + "\n"


def held_out_errors(record: Mapping[str, Any]) -> tuple[FloatArray, FloatArray] | None:
    """Return the errors of simulation and model on motion held out, (n,) [N m] each, if known.

    Args:
        record: Of a model that was fitted.
    """
    rmse, choice = record.get("rmse", {}), record.get("choice", {})
    chosen = [one for one in choice.get("tried", ()) if one["name"] == choice["chosen"]]
    if chosen and "left" in chosen[0]:
        simulation = np.array(choice["simulation"])
        return simulation, simulation * np.array(chosen[0]["left"])
    if {"simulation", "held_out"} <= set(rmse):
        return np.array(rmse["simulation"]), np.array(rmse["held_out"])
    if "held_out" not in rmse:
        return None
    training, held = rmse["training"], rmse["held_out"]
    if "left_out" not in rmse:
        return np.array(held["rigid_body"]), np.array(held["hybrid"])
    part = record["settings"]["held_out"]  # stretches that are left out in turn are all of it
    squares = (np.square(one["rigid_body"]) for one in (training, held))
    every = np.sqrt(sum(w * square for w, square in zip((1.0 - part, part), squares, strict=True)))
    return every, np.array(rmse["left_out"]["hybrid"])


def limits(model: ResidualModel[Any]) -> tuple[str, ...]:
    """Say where a model must not be believed.

    Args:
        model: Fitted.
    """
    carried = model.simulation.model.link_names[-1]
    return (
        "It knows the arm with what was mounted on it in the recordings, and nothing of another "
        f"load: after a change of the payload at {carried}, both the simulation and what was "
        "learned are of the old one, and no interval and no flag shows it without measured torque. "
        "Identify and train again, or give the simulation its new payload and train on it.",
        "Motion unlike what it learned from is flagged as outside; its intervals are a guess "
        "there.",
        "Friction follows temperature and grease from one day to the next, which no interval has: "
        "`limo evaluate` tells offset and friction since training where torque is measured.",
        f"It follows motion and torque up to {model.bandwidth:g} Hz.",
        "It estimates torque. It is no safety function.",
    )


def _headline(errors: tuple[FloatArray, FloatArray] | None, names: Sequence[str]) -> str:
    if errors is None:
        return "it does not say how large its errors are."
    left = errors[1] / np.maximum(errors[0], _LEAST)
    mean = float(np.exp(np.mean(np.log(np.maximum(left, _LEAST)))))
    worst = int(np.argmax(left))
    return (
        f"{100 * mean:.2g} % of the simulation's error is left on motion held out (geometric mean "
        f"over joints), at most {100 * left[worst]:.2g} %, at {names[worst]}."
    )


def _errors(
    errors: tuple[FloatArray, FloatArray], names: Sequence[str], unit: str, charts: Charts
) -> str:
    sides = [
        ("simulation", errors[0], "circle-open", BEFORE),
        ("model", errors[1], "circle", AFTER),
    ]
    chart = joint_errors(sides, names, unit)
    return charts.place(chart, "Error on motion held out")


def _tried(choice: Mapping[str, Any] | None, names: Sequence[str]) -> str:
    """Return what was compared; nothing where a model was asked for by its name."""
    if choice is None:
        return ""
    values: dict[str, list[object]] = {"joint": list(names)}
    refused: list[str] = []
    for one in choice["tried"]:
        if one.get("refused"):
            refused.append(f"{one['name']} was not compared: {one['refused']}")
        elif one["name"] != "simulation":
            values[one["name"]] = [f"{left:.2f}" for left in one["left"]]
            if one.get("coverage"):
                values[f"{one['name']}: within 95 %"] = [f"{part:.0%}" for part in one["coverage"]]
    return paragraph(f"Chosen: {choice['chosen']}.") + columns(values) + listed(refused)


def _curves(epochs: Sequence[Mapping[str, Any]], charts: Charts) -> str:
    """Return the losses by epoch; nothing of a model that is fitted in closed form."""
    if not epochs:
        return ""
    number = np.array([epoch["number"] for epoch in epochs], dtype=float)
    trained, held = (
        np.array([epoch[name] for epoch in epochs], dtype=float)
        for name in ("training_loss", "held_out_loss")
    )
    axes = layout("epoch", "loss")
    axes["yaxis"] |= {"type": "log"}
    lines = [
        curve(number, trained, "trained on", "#8a94a0"),
        curve(number, held, "held out", AFTER),
    ]
    return charts.place({"data": lines, "layout": axes}, "Loss by epoch")


def _data(recordings: Sequence[Recording]) -> dict[str, list[object]]:
    return {
        "recording": [one.source.rpartition("/")[2] or "unnamed" for one in recordings],
        "samples": [len(one) for one in recordings],
        "seconds": [f"{one.time[-1] - one.time[0]:.0f}" for one in recordings],
        "rate [Hz]": [f"{one.rate:.4g}" for one in recordings],
        "rows left out": [sum(len(item.rows) for item in one.left_out) for one in recordings],
    }


def _ranges(model: ResidualModel[Any], recordings: Sequence[Recording]) -> dict[str, list[object]]:
    """Return from where to where each joint moved, how fast, and with which torque."""
    robot = model.simulation.model
    position = np.concatenate([one.position for one in recordings])
    speed = [np.abs(one.motion(model.bandwidth).velocity).max(axis=0) for one in recordings]
    torque = np.concatenate([one.torque for one in recordings])
    turn, push = ([unit_of(u, robot.sliding, j) for j in range(robot.n)] for u in ("rad", "N m"))
    joints = range(robot.n)
    return {
        "joint": list(robot.joint_names),
        "from": [f"{position[:, j].min():.2f} {turn[j]}" for j in joints],
        "to": [f"{position[:, j].max():.2f} {turn[j]}" for j in joints],
        "fastest": [f"{np.max(speed, axis=0)[j]:.2f} {turn[j]}/s" for j in joints],
        "largest torque": [f"{np.abs(torque[:, j]).max():.3g} {push[j]}" for j in joints],
    }
