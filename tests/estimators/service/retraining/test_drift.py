"""Drift is told where the residual grew for long, and nowhere else."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimators.service.inference.live_model import History, Window
from estimators.service.retraining.drift import DriftDetector, DriftWatch
from limo_driver.errors import MissingPackageError, ShapeError

RATE = 100.0
ALL = np.array([True, True])


def residual(seconds: int, seed: int = 0) -> np.ndarray:
    """Mean squares of two joints, second by second, that scatter as those of real arms do."""
    random = np.random.default_rng(seed)
    x, values = np.zeros(2), np.empty((seconds, 2))
    for k in range(seconds):
        x = 0.4 * x + np.sqrt(1 - 0.4**2) * random.standard_normal(2)
        values[k] = 0.01 * np.exp(x)
    return values


def told(detector: DriftDetector, values: np.ndarray) -> list[tuple[int, tuple[int, ...]]]:
    found = ((k, detector.step(value, ALL)) for k, value in enumerate(values))
    return [(k, joints) for k, joints in found if joints]


class TestDetector:
    @pytest.mark.slow("hours of residuals")
    def test_hours_of_the_same_residual_are_no_drift(self) -> None:
        assert not told(DriftDetector(2), residual(4 * 3600))

    @pytest.mark.parametrize("seed", range(5))
    def test_a_doubled_residual_is_told_in_two_minutes_on_its_joint(self, seed: int) -> None:
        values = residual(720, seed)
        values[600:, 1] *= 4.0
        (when, joints), *_ = told(DriftDetector(2), values)
        assert joints == (2,)
        assert 600 < when < 720

    def test_a_shorter_reference_finds_a_large_change_sooner(self) -> None:
        values = residual(110)
        values[60:, 0] *= 100.0
        assert not told(DriftDetector(2), values)
        (when, joints), *_ = told(DriftDetector(2, fewest=40), values)
        assert joints == (1,)
        assert 60 < when < 85

    def test_a_smaller_residual_is_none(self) -> None:
        values = residual(1200)
        values[600:] /= 4.0
        assert not told(DriftDetector(2), values)

    def test_some_seconds_of_anything_are_none(self) -> None:
        values = residual(1200)
        values[600:608] *= 1e4
        assert not told(DriftDetector(2), values)

    def test_a_residual_of_zero_is_a_residual(self) -> None:
        assert not told(DriftDetector(2), np.zeros((300, 2)))

    def test_seconds_that_say_nothing_are_not_taken(self) -> None:
        detector = DriftDetector(2)
        detector.step(np.array([1.0, np.nan]), ALL)
        detector.step(np.array([1.0, 1.0]), np.array([False, True]))
        assert detector.windows.tolist() == [1, 1]

    def test_another_number_of_joints_is_refused(self) -> None:
        with pytest.raises(ShapeError, match="mean_square"):
            DriftDetector(2).step(np.ones(3), ALL)

    def test_says_what_to_install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "river", None)
        with pytest.raises(MissingPackageError, match="pip install 'river"):
            DriftDetector(2)


class TestWatch:
    """Windows of a service in which the second joint's residual doubled."""

    def told(self, **differing: Any) -> bool:
        given = {"contact": False, "outside": 0.0, "travel": 0.1, "version": lambda _: "1"}
        given |= differing
        watch, history = DriftWatch(2), History(2, 1000)
        for k in range(int(2 * RATE)):
            history.append(k / RATE, np.array([0.0, given["travel"] * k / RATE]), np.zeros(2))
        values = residual(780)
        values[600:, 1] *= 4.0
        found: list[tuple[int, ...]] = []
        for k, value in enumerate(values):
            window = Window(2)
            window.count, window.samples = int(RATE), np.full(2, RATE)
            window.squares, window.outside = RATE * value, np.full(2, RATE * given["outside"])
            watch.take(window, contact=given["contact"] and k >= 600)
            model = SimpleNamespace(version=given["version"](k))
            service: Any = SimpleNamespace(
                model=model, history=history, arm=SimpleNamespace(rate=RATE)
            )
            found.append(watch.drifting(service))
        assert set(found) <= {(), (2,)}
        return (2,) in found

    def test_tells_it(self) -> None:
        assert self.told()

    @pytest.mark.parametrize(
        "differing",
        [
            {"contact": True},
            {"outside": 0.1},
            {"travel": 1e-5},
            {"version": lambda k: str(k // 100)},
        ],
        ids=["something leans on it", "motion not learned", "at rest", "models take turns"],
    )
    def test_is_silent_where_it_says_nothing_of_the_model(self, differing: dict[str, Any]) -> None:
        assert not self.told(**differing)
