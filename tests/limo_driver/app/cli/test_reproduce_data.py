"""Data that `limo reproduce table1` makes with the simulated arm."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.studies.table1_data import TableData
from limo_driver.app.cli.reproduce.simulated_data import (
    Size,
    make,
    repeated,
    scaffold_starts,
    simulated_arm,
)
from limo_driver.trajectory import Segment, Trajectory
from limo_driver.types import Motion
from limopa.excitation.search import ExcitationRequest


def swing(duration=2.0):
    """Return a motion out and back, at rest at both ends."""
    time = np.linspace(0.0, duration, 201)
    u = 2 * np.pi / duration
    phase = u * time
    position = np.outer(1 - np.cos(phase), [0.1, -0.2])
    velocity = np.outer(u * np.sin(phase), [0.1, -0.2])
    acceleration = np.outer(u**2 * np.cos(phase), [0.1, -0.2])
    return Trajectory(time, position, velocity, acceleration, robot="arm")


def test_a_motion_is_repeated_ever_slower():
    motion = swing()
    longer = repeated(motion, (1.0, 2.0, 4.0))
    assert longer.duration == pytest.approx(7 * motion.duration)
    assert len(longer) == 3 * len(motion) - 2
    peaks = [
        np.abs(longer.velocity[(longer.time > a) & (longer.time < b)]).max()
        for a, b in ((0, 2), (2, 6), (6, 14))
    ]
    np.testing.assert_allclose(peaks, [peaks[0], peaks[0] / 2, peaks[0] / 4], rtol=1e-9)
    slope = np.gradient(longer.position[:, 0], longer.time)
    np.testing.assert_allclose(slope[5:-5], longer.velocity[5:-5, 0], atol=0.01)


def test_scaffolds_start_with_their_reach():
    motion = swing()
    kinds = (("exploring", 0, 50), ("reaching", 50, 80), ("exploring", 80, 150))
    segments = (*(Segment(*kind) for kind in kinds), Segment("reaching", 150, 201))
    planned = replace(motion, segments=segments)
    assert scaffold_starts(planned) == [0.0, motion.time[50], motion.time[150]]


def test_the_arm_is_the_one_of_the_examples(hysteretic):
    time = np.arange(2000) / 250.0
    angle = 2 * np.pi * np.outer(time, np.linspace(0.1, 0.4, 7))
    position = 0.3 + 0.2 * np.sin(angle)
    torques = [
        arm.predict(
            Motion(time, position, np.gradient(position, time, axis=0), np.zeros_like(position))
        )
        for arm in (simulated_arm(), hysteretic)
    ]
    np.testing.assert_allclose(torques[0], torques[1], atol=2e-3)
    assert simulated_arm().sensors == hysteretic.sensors


@pytest.mark.slow("plans, runs and records a folder of motions")
def test_a_folder_is_made_whole(tmp_path):
    request = ExcitationRequest(duration=20.0, starts=1, iterations=0)
    told = []
    folder = tmp_path / "data"
    assert make(folder, Size(2, request, request, (1.0,)), lambda what, _: told.append(what))
    data = TableData.load(folder)
    assert "MuJoCo" in data.made_by
    assert len(data.scaffolds()) == 2
    reach = data.scaffolds()[1].position[:250]  # a second of it, against one of exploring
    explored = data.scaffolds()[1].position[-250:]
    assert np.ptp(reach, axis=0).max() > np.ptp(explored, axis=0).max()
    assert {"planning LIMOPA motion", "recording limo.parquet"} <= set(told)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
