"""The latest states of an arm."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.service.inference.live_model import History


class TestHistory:
    def test_keeps_the_latest_states(self) -> None:
        history = History(1, 10)
        for k in range(10_000):
            history.append(0.1 * k, np.array([k]), np.array([-k]))
        assert history.first == 9990
        rows = history.since(history.first, 4)
        np.testing.assert_array_equal(rows.position[:, 0], [9990, 9991, 9992, 9993])
        np.testing.assert_array_equal(rows.torque[:, 0], [-9990, -9991, -9992, -9993])

    def test_says_what_is_no_longer_kept(self) -> None:
        history = History(1, 10)
        for k in range(10_000):
            history.append(0.1 * k, np.array([k]), None)
        with pytest.raises(IndexError, match="no longer kept"):
            history.since(0)
        assert history.since(history.first).torque is None

    def test_begins_anew(self) -> None:
        history = History(1, 10)
        for k in range(5):
            history.append(0.1 * k, np.array([k]), None)
        history.restart()
        assert history.first == 5
        assert not len(history.since(5).time)
