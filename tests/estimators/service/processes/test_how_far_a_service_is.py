"""Real processes: a service says how far it is, and shells, programs and drivers wait for it."""

from __future__ import annotations

import json
import signal
import subprocess
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
import pytest
from processes import ARM, PATIENCE, driven, limo, served, slow_motion, wait_for

from limo_driver.errors import ServiceNotReadyError
from limo_driver.network.readiness import ServicePhase, ServiceWatch, wait_until_serving
from limo_driver.network.streaming import Keys, open_session

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from processes import Network

    from estimators.service.store.store import ModelStore

pytestmark = pytest.mark.waits

ORDER = ["loading", "compiling", "waiting", "preparing", "serving"]


@pytest.fixture
def trajectory(tmp_path: Path, two_links_urdf: Path) -> Path:
    """A second of slow motion, beside the arm that it is of."""
    return slow_motion(tmp_path, 1.0, two_links_urdf)


def run(network: Network, trajectory: Path, *given: object) -> list[str]:
    """Return the command of a driver that streams."""
    arm = ("--robot", trajectory.with_name("two_links.urdf"), "--name", ARM)
    record = ("--record", trajectory.with_name("run.parquet"), "--zenoh-config", network.there)
    backend = ("--backend", "virtual", "--trajectory", trajectory, "--stream")
    return limo("run", *backend, *arm, *record, *given)


def ended(command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def watch(network: Network, *given: object) -> subprocess.CompletedProcess[str]:
    return ended(limo("watch", *given, "--zenoh-config", network.there))


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.slow("starts services as processes and waits until they serve")
def test_a_service_says_how_far_it_is_on_its_output_and_on_the_network(
    store: ModelStore, network: Network, as_json: bool
) -> None:
    given = ["--arm", ARM, "--store", store.root, *(["--json"] if as_json else [])]
    with (
        open_session(config=network.here) as session,
        served(network, *given, stdout=subprocess.PIPE, text=True) as service,
    ):
        waiting = watch(network, "--arm", ARM, "--until", "waiting", "--timeout", PATIENCE)
        assert waiting.stdout == f"{ARM}: waiting for joint states\n", waiting.stderr
        with ServiceWatch(session, ARM) as heard:
            heard.wait("waiting", PATIENCE)
            with pytest.raises(ServiceNotReadyError, match="said 'waiting for joint states'"):
                heard.wait(timeout=0.01)
        with driven(session):
            assert wait_until_serving(session, ARM, timeout=PATIENCE).phase is ServicePhase.SERVING
            late = watch(network, "--until", "preparing", "--timeout", PATIENCE, "--json")
            said = {"arm": ARM, "phase": "serving", "state": "serving"}
            assert json.loads(late.stdout) == said, late.stderr
        service.send_signal(signal.SIGINT)
        lines = service.communicate(timeout=PATIENCE)[0].splitlines()
    if as_json:
        events = [line for line in map(json.loads, lines) if "phase" in line]
        phases = [event["event"] for event in events]
        assert phases == [event["phase"] for event in events]
        statuses = [line["status"] for line in map(json.loads, lines) if "status" in line]
        assert {"waiting", "serving"} <= {status["phase"] for status in statuses}
    else:
        phases = [line.split(":")[0] for line in lines]
    assert phases[: len(ORDER)] == ORDER


@pytest.mark.slow("compiles all that a service needs")
def test_a_service_that_compiles_while_it_loads_says_so_and_stays_there(
    store: ModelStore, network: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "empty"))  # so that it compiles
    given = ["--arm", ARM, "--store", store.root]
    with (
        open_session(config=network.here) as session,
        served(network, *given, stdout=subprocess.PIPE, text=True) as service,
    ):
        wait_until_serving(session, ARM, until="waiting", timeout=PATIENCE)
        service.send_signal(signal.SIGINT)
        lines = service.communicate(timeout=PATIENCE)[0].splitlines()
    assert lines[0] == "loading: loading models and physics"
    assert [line.split(":")[0] for line in lines[:3]] == ORDER[:3]


@pytest.mark.slow("starts two services and a driver")
def test_a_driver_stands_until_estimates_come_and_then_moves(
    store: ModelStore, network: Network, trajectory: Path
) -> None:
    wait = ("--wait-for-estimates", PATIENCE)
    with (
        open_session(config=network.here) as session,
        subprocess.Popen(run(network, trajectory, *wait), stdout=subprocess.DEVNULL) as driver,
    ):
        stood: list[bytes] = []
        with session.declare_subscriber(Keys(ARM).joints, lambda s: stood.append(bytes(s.payload))):
            wait_for(lambda: len(stood) > 100)  # before there is a service
        assert not trajectory.with_name("run.parquet.partial").exists()
        with served(network, "--arm", ARM, "--store", store.root):
            assert driver.wait(PATIENCE) == 0
    table = pq.read_table(trajectory.with_name("run.parquet"))
    assert table["time"][0].as_py() == 0.0
    assert table["time"][-1].as_py() == pytest.approx(0.95)


@pytest.mark.slow("real processes that start and wait, seconds each")
def test_a_driver_that_waited_in_vain_does_not_move(network: Network, trajectory: Path) -> None:
    with open_session(config=network.here):
        vain = ended(run(network, trajectory, "--wait-for-estimates", 0.5))
    assert vain.returncode == 1
    assert f"limo: no service of arm '{ARM}' was serving within 0.5 s" in vain.stderr
    assert "Traceback" not in vain.stderr
    assert not list(trajectory.parent.glob("run.parquet*"))


@pytest.mark.slow("real processes that start and wait, seconds each")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_driver_that_waits_is_interrupted_in_one_line(
    network: Network, trajectory: Path, number: signal.Signals
) -> None:
    command = run(network, trajectory, "--wait-for-estimates", PATIENCE)
    with (
        open_session(config=network.here) as session,
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as driver,
    ):
        stood: list[object] = []
        with session.declare_subscriber(Keys(ARM).joints, stood.append):
            wait_for(lambda: len(stood) > 10)
        driver.send_signal(number)
        _, said = driver.communicate(timeout=PATIENCE)
    assert driver.returncode == 130
    assert said.splitlines()[-1] == "limo: interrupted before the arm moved; nothing was recorded"
    assert "Traceback" not in said
    assert not list(trajectory.parent.glob("run.parquet*"))


@pytest.mark.slow("starts a process, which waits in vain")
def test_a_shell_that_waits_in_vain_is_told_so(network: Network) -> None:
    with open_session(config=network.here):
        vain = watch(network, "--arm", "nobody", "--until", "serving", "--timeout", 0.5)
    assert (vain.returncode, vain.stdout) == (1, "")
    assert vain.stderr.startswith("limo: no service of arm 'nobody' was serving within 0.5 s: none")
    assert vain.stderr.count("\n") == 1
