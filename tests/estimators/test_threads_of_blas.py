"""Fits keep BLAS to one thread: on small matrices, more wait for each other on busy cores."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from lanes import sampled
from servo_arms import commands, recorded, write_arm
from threadpoolctl import threadpool_info, threadpool_limits

from estimators.base import check_recordings
from estimators.diagnosis.from_motion import diagnose_drives, pipeline
from estimators.diagnosis.from_motion.fitting import identification
from estimators.joint_physics import JointPhysics
from estimators.rigid_body import identify
from limo_driver.errors import RecordingError
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.recordings.recording import Recording


def threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@sampled("where", ["rigid_body.fitting", "joint_physics"], "fits an arm each")
def test_fits_keep_blas_to_one_thread_and_give_the_others_back(
    rigid: Simulation, training_recording: Recording, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def checked(*given: object) -> None:
        told.append(threads())
        check_recordings(*given)

    told: list[set[int]] = []
    monkeypatch.setattr(f"estimators.{where}.normal_equations.check_recordings", checked)
    with threadpool_limits(2, user_api="blas"):
        if where == "rigid_body.fitting":
            identify(rigid.model, [training_recording])
        else:
            JointPhysics(rigid).fit([training_recording])
        assert threads() == {2}
    assert told == [{1}]


@pytest.mark.parametrize("within", [(pipeline, "check_commanded"), (identification, "rows_of")])
def test_so_do_those_without_torque(
    within: tuple[object, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[set[int]] = []

    def refused(*_: object) -> None:
        told.append(threads())
        raise RecordingError("enough")

    monkeypatch.setattr(*within, refused)
    given = Simulation.load(write_arm(tmp_path / "arm.xml"))
    time, command = commands(4.0, 50.0)
    own = diagnose_drives if within[0] is pipeline else identification.fit_drives
    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(RecordingError, match="enough"):
            own(given, [recorded(time, command, 0.9 * command)])
        assert threads() == {2}
    assert told == [{1}]
