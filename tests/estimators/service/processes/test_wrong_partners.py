"""A driver, a plan and a service that do not belong together: one line each, and nothing moves."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from ports import free_port
from processes import ARM, PATIENCE, driven, limo, served, slow_motion, wait_for

from limo_driver.network.readiness import ServiceWatch
from limo_driver.network.streaming import Keys, is_alive, open_session
from limo_driver.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Generator

    from processes import Network

    from estimators.service.store.store import ModelStore

pytestmark = [
    pytest.mark.waits,
    pytest.mark.slow("starts services and drivers as processes, seconds each"),
]
EXAMPLES = Path(__file__).parents[4] / "examples"
VAIN = 3.0  # [s] of waiting for what cannot come


@pytest.fixture
def service(store: ModelStore, network: Network) -> Generator[None]:
    """Serve an arm of two links, until it waits for joint states and to the end of the test."""
    with (
        open_session(config=network.here) as session,
        served(network, "--arm", ARM, "--store", store.root),
        ServiceWatch(session, ARM) as watch,
    ):
        watch.wait("waiting", PATIENCE)
        yield


def streaming(network: Network, name: str = ARM) -> tuple[object, ...]:
    """Return the options of a driver that streams."""
    return ("--stream", "--name", name, "--zenoh-config", network.there)


@pytest.fixture
def two_links(tmp_path: Path, two_links_urdf: Path) -> tuple[object, ...]:
    """Return the options of a driver of two links, with a motion for them."""
    motion = slow_motion(tmp_path, 1.0, two_links_urdf)
    robot = tmp_path / "two_links.urdf"
    return ("--backend", "virtual", "--robot", robot, "--trajectory", motion)


def motion_of(robot: str, n: int, folder: Path) -> Path:
    """Write a slow motion of a built-in robot."""
    t = np.arange(0.0, 1.0, 0.05)[:, None]
    path = folder / f"{robot}.traj.parquet"
    swing = np.ones((1, n))
    Trajectory(
        time=t[:, 0],
        position=np.linspace(0.3, -0.3, n) - 0.05 * (1.0 - np.cos(t)) * swing,
        velocity=-0.05 * np.sin(t) * swing,
        acceleration=-0.05 * np.cos(t) * swing,
        robot=robot,
    ).save(path)
    return path


def refused(folder: Path, *given: object) -> str:
    """Run an arm that has to stand still, and return the one line that says why."""
    record = folder / "run.parquet"
    done = subprocess.run(
        limo("run", *given, "--record", record),
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert done.returncode in {1, 2}, done.stderr
    assert not list(folder.glob("run.parquet*"))
    lines = [line for line in done.stderr.splitlines() if "stands until" not in line]
    assert len(lines) == 1, done.stderr
    return lines[0]


@pytest.mark.parametrize(
    "arm",
    [
        ("virtual", "--robot", "iiwa14"),
        ("mujoco", "--robot", "iiwa14"),
        ("fri", "--port", free_port()),  # nobody is there: what it says, it says before it listens
        ("can", "--config", EXAMPLES / "can_cia402.yaml"),
    ],
    ids=lambda arm: arm[0],
)
def test_a_plan_for_another_robot(arm: tuple[object, ...], tmp_path: Path) -> None:
    plan = motion_of("other", 7, tmp_path)
    said = refused(tmp_path, "--backend", *arm, "--trajectory", plan)
    assert "other.traj.parquet: the trajectory was planned for other, but the robot is" in said


@pytest.mark.usefixtures("service")
def test_a_service_that_serves_another_arm(network: Network, tmp_path: Path) -> None:
    given = ("--backend", "virtual", "--trajectory", motion_of("iiwa14", 7, tmp_path))
    said = refused(tmp_path, *given, *streaming(network), "--wait-for-estimates", VAIN)
    assert f"no service of arm '{ARM}' was serving within {VAIN:g} s" in said
    assert f"and {ARM!r} is served as two_links" in said


@pytest.mark.usefixtures("service")
def test_a_service_of_another_name(
    network: Network, tmp_path: Path, two_links: tuple[object, ...]
) -> None:
    stream = streaming(network, "left")
    said = refused(tmp_path, *two_links, *stream, "--wait-for-estimates", VAIN)
    assert f"there are services of {ARM!r} only" in said


@pytest.mark.usefixtures("service")
def test_states_at_another_rate_than_the_model_can_follow(
    network: Network, tmp_path: Path, two_links: tuple[object, ...]
) -> None:
    stream = ("--rate", 10, *streaming(network))
    said = refused(tmp_path, *two_links, *stream, "--wait-for-estimates", 4 * VAIN)
    assert "10 Hz" in said


def test_two_drivers_of_one_arm(
    network: Network, tmp_path: Path, two_links: tuple[object, ...]
) -> None:
    with open_session(config=network.here) as session, driven(session):
        wait_for(lambda: is_alive(session, Keys(ARM).alive("driver")))
        said = refused(tmp_path, *two_links, *streaming(network))
    assert f"another driver of an arm called {ARM!r} is on the network already" in said


def test_two_drivers_behind_one_controller(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        port = other.getsockname()[1]
        plan = motion_of("iiwa14", 7, tmp_path)
        said = refused(tmp_path, "--backend", "fri", "--port", port, "--trajectory", plan)
    assert f"UDP port {port} is taken by another program" in said
