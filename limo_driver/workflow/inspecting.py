"""Inspect a log: what is there, how it is to be read, and what is still to be decided."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from limo_driver.errors import LimoError
from limo_driver.foreign.inspection import Inspection
from limo_driver.foreign.proposals.proposal import propose, without_questions
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.recordings.recording import Recording
from limo_driver.workflow.inputs import model_of
from limo_driver.workflow.reading import table_of_log

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.foreign.proposals.proposal import Proposal
    from limo_driver.model import RobotModel


def inspect(
    log: Path | str | Mapping[str, Any],
    robot: RobotModel | Path | str,
    *,
    topic: str | None = None,
    episode: int | None = None,
) -> Inspection:
    """Say what a log of a robot holds, and propose how to read it.

    Args:
        log: A file or folder: delimited text, Parquet, NumPy's .npz, a ROS 2 bag (MCAP or .db3),
            a LeRobotDataset; or arrays by name, (T,) or (T, k) each.
        robot: Whose log it is: a model, a built-in name, or the path of its description.
        topic: Of the joint states of a bag, where there are several.
        episode: Of a LeRobotDataset; all of them, with gaps between, if not given.

    Returns:
        What was found; its `mapping` can be saved, changed and given to `limo.read`, once its
        `questions` are answered.

    Raises:
        RecordingError: The log cannot be read, or has no positions of the robot's joints.

    Example:
        >>> q = np.sin(0.01 * np.arange(500))[:, None] * np.ones(7)
        >>> log = {"t_ms": 4.0 * np.arange(500), "q": q, "tau_nm": np.cos(q)}
        >>> print(limo.inspect(log, "iiwa14"))
    """
    model = model_of(robot)
    table = table_of_log(log, model, topic=topic, episode=episode)
    proposal = propose(table, model)
    model = proposal.model
    if topic is not None:
        proposal = replace(proposal, mapping=replace(proposal.mapping, topic=topic))
    recording, refused = None, ""
    try:
        columns = without_questions(proposal).columns(table, model)
        recording = Recording.from_columns(columns, table.source)
        recording.check_robot(model)
    except LimoError as error:
        refused = str(error).removeprefix(f"{table.source}: ")
    told: tuple[str, ...] = ()
    said = (proposal.told,) if proposal.told else ()
    if recording is not None:
        told, refused = _judged(recording, model)
        if refused:
            proposal = _asking(proposal, refused)
    return Inspection(table, proposal, recording, refused, told, (*said, *model.notes))


def _asking(proposal: Proposal, refused: str) -> Proposal:
    """Return a proposal that cannot be used before it is said what is meant instead."""
    question = (
        f"read as proposed it is refused: {refused}: which columns, signs or units are meant?"
    )
    undecided = (*proposal.mapping.undecided, question)
    return replace(proposal, mapping=replace(proposal.mapping, undecided=undecided))


def _judged(recording: Recording, model: RobotModel) -> tuple[tuple[str, ...], str]:
    """Return what a recording is worth, and why identification and diagnosis would refuse it."""
    from estimators.diagnosis.residuals.plausibility import doubts_about
    from estimators.drives.checks.commands import check_commands
    from estimators.telemetry import telemetry_of

    try:
        if not recording.has_torque:  # by which signs and order of the columns are checked
            told = check_commands([recording])
            return (*telemetry_of(recording, model).lines(), *told), ""
        doubts = doubts_about(model, [recording], bandwidth_for([recording]))
    except LimoError as error:
        return (), str(error).removeprefix(f"{recording.source}: ")
    return (*telemetry_of(recording, model).lines(), *doubts), ""
