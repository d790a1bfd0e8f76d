"""What `limo watch --rerun` logs, read back with Rerun's own command line."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from limo_driver.app.live.rerun_log import RerunLog, _from_z
from limo_driver.errors import ConfigError, MissingPackageError
from limo_driver.model import RobotModel
from limo_driver.network.messages import Event
from limo_driver.network.messages.torque_estimate import Level

N, CYCLES = 7, 40
CHUNK = re.compile(
    r"with (\d+) rows .* - (/\S+) - data columns: \[.*@(Scalars|Transform3D|TextLog)"
)


@pytest.fixture(scope="module")
def model():
    return RobotModel.load("iiwa14")


def snapshot(k, **changes):
    """Return what a feed shows in its cycle k."""
    stamp = 1.7e9 + 0.05 * k
    shown = {
        "position": [0.01 * k] * N, "stamp": stamp, "estimate_stamp": stamp,
        "torque": [1.0] * N, "interval": [0.1] * N, "external": [0.2] * N, "measured": [1.2] * N,
        "force": [0.0, 10.0, -5.0],
    }  # fmt: skip
    return shown | changes


def rows(path):
    """Return how many values a file has of each entity."""
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-v", path],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = Counter()
    for line in done.stdout.splitlines():
        if match := CHUNK.search(line):
            found[match[2]] += int(match[1])
    return found


def test_a_file_has_poses_torques_and_events_once_each(tmp_path, model):
    pytest.importorskip("rerun", reason="the extra limo[rerun] is not installed")
    path = tmp_path / "arm.rrd"
    with RerunLog("arm", model, str(path)) as log:
        log.take({})  # before anything came
        for k in range(CYCLES):
            for _ in range(2):  # looked at twice, with nothing new
                log.take(snapshot(k))
        unknown = {"torque": [None] * N, "measured": [None] * N, "external": [None] * N}
        log.take(snapshot(CYCLES, force=None, **unknown))
        event = Event(10**18, Level.WARN, "contact", "somebody pushes")
        for data in (event.encode(), b"no event"):
            log.take_event(SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda d=data: d)))
    found = rows(path)
    for name in model.joint_names:
        assert found[f"/arm/arm/{name}"] == CYCLES + 1
        for series in ("measured", "estimated", "lower", "upper"):
            assert found[f"/arm/torque/{name}/{series}"] == CYCLES
    assert found["/arm/events"] == 1


@pytest.mark.parametrize(
    ("target", "said"),
    [
        (
            "arm.mcap",
            "'arm.mcap' is no place .* expected viewer, a file that ends in .rrd, or an address",
        ),
        ("", "'' is no place"),
        ("nowhere/arm.rrd", "its folder is not there"),
    ],
)
def test_other_targets_are_refused(tmp_path, monkeypatch, model, target, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        RerunLog("arm", model, target)


def test_without_rerun_it_says_what_to_install(monkeypatch, model):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingPackageError, match="pip install 'rerun-sdk"):
        RerunLog("arm", model, "viewer")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--rerun", "viewer"], "--rerun shows one arm: name it with --arm"),
        (["--rerun", "viewer", "--web", "--arm", "a"], "give one of them"),
        (["--rerun", "viewer", "--until", "serving"], "--rerun is for watching"),
        (["--robot", "iiwa14"], "--robot is of what --web or --rerun draws"),
    ],
)
def test_options_that_do_not_go_together_are_refused(limo, options, said):
    done = limo("watch", *options)
    assert done.returncode
    assert said in done.stderr


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -2), (1, 0, 0), (0.3, -0.4, 0.5)])
def test_capsules_point_where_they_should(direction):
    x, y, z, w = _from_z(np.array(direction, dtype=float))
    turned = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert turned == pytest.approx(np.array(direction) / np.linalg.norm(direction), abs=1e-12)
