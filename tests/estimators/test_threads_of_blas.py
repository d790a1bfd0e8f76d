"""Fits keep BLAS to one thread: on small matrices, more wait for each other on busy cores."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from estimators.joint_physics import JointPhysics
from estimators.recordings import check_recordings
from estimators.rigid_body import identify

if TYPE_CHECKING:
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording


@pytest.mark.parametrize("where", ["rigid_body", "joint_physics"])
def test_fits_keep_blas_to_one_thread_and_give_the_others_back(
    rigid: Simulation, training_recording: Recording, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    def checked(*given: object) -> None:
        told.append(threads())
        check_recordings(*given)

    told: list[set[int]] = []
    monkeypatch.setattr(f"estimators.{where}.normal_equations.check_recordings", checked)
    with threadpool_limits(2, user_api="blas"):
        if where == "rigid_body":
            identify(rigid.model, [training_recording])
        else:
            JointPhysics(rigid).fit([training_recording])
        assert threads() == {2}
    assert told == [{1}]
