"""Clients that share no code with limo, as processes, against `limo controller`, as another."""

from __future__ import annotations

import json
import math
import signal
import subprocess

import pytest
from controller_runs import LIMO, PATIENCE, process, session
from lanes import sampled
from ports import free_port

pytestmark = pytest.mark.waits

ORDER = ["IDLE", "MONITORING_WAIT", "MONITORING_READY", "COMMANDING_WAIT", "COMMANDING_ACTIVE"]


@sampled(
    ("version", "generation", "mode", "period", "multiplier"),
    [
        ("1.11", "1", "torque", 5, 1),
        ("1.15", "1", "position", 3, 3),
        ("1.16", "1", "wrench", 4, 1),
        ("2.5", "2.5", "position", 5, 1),
        ("2.7", "2.7", "torque", 2, 2),
        ("2.7", "2.7", "wrench", 5, 1),
    ],
    "sessions with processes of their own, at the pace of a real controller",
)
def test_an_unmodified_client_is_led_through_a_session(
    version: str, generation: str, mode: str, period: int, multiplier: int
) -> None:
    amplitude = 0.02 if mode == "position" else 2.0
    run = session(
        ("--generation", generation, "--mode", mode, "--amplitude", str(amplitude)),
        process_of_its_own=version == "1.15",
        fri=version,
        mode=mode,
        period_ms=period,
        multiplier=multiplier,
    )
    assert run.client_status == 0, run.client  # it left at IDLE, and could read all before
    assert run.client["states"][-1] == 0
    seen = [ORDER[state] for state in dict.fromkeys(run.client["states"])]
    assert seen == [*ORDER[1:], "IDLE"]
    assert list(dict.fromkeys(run.states)) == ORDER
    assert run.client["period"] == period
    assert run.client["quality"] >= 2
    assert run.client["tracking"] > 0.5
    packets = run.report["packets"]
    assert packets["answered"] == run.client["answers"]
    assert packets["malformed"] == packets["repeated"] == packets["unknown"] == 0
    assert packets["gaps"] == packets["restarts"] == 0
    assert run.client["answers"] <= run.client["received"] / multiplier
    control = {"position": {0}, "wrench": {0, 1}, "torque": {0, 2}}[mode]
    assert set(run.client["control"]) == control
    _check_commands(run.report["commands"], mode, amplitude)
    assert run.complaints == ""


def _check_commands(commands: dict, mode: str, amplitude: float) -> None:
    """Compare what the controller understood with what the client packed."""
    if mode == "position":
        assert 0.3 * amplitude < commands["position"]["upper"][6] <= amplitude + 1e-12
    elif mode == "torque":
        assert 0.3 * amplitude < commands["torque"]["upper"][6] <= amplitude
    else:
        assert commands["wrench"]["upper"][2] == 20.0 * amplitude
        assert commands["wrench"]["upper"][:2] == [0.0, 0.0]


@sampled(
    ("wrong", "complaint"),
    [
        ("jump", "illegal axis delta: joint 1 is told to jump by 0.5"),
        ("garbage", "no command of FRI 1.15"),
        ("stale", "an answer reflects a packet that was answered before"),
    ],
    "sessions with processes of their own, at the pace of a real controller",
)
def test_a_wrong_client_is_told_what_is_wrong_and_does_no_harm(wrong: str, complaint: str) -> None:
    run = session(("--wrong", wrong), period_ms=4)
    assert complaint in run.complaints
    assert run.client["states"][-1] == 0
    assert run.report["states"][-1]["state"] == "IDLE"
    assert math.fabs(run.client["measured"][0]) < 0.01  # the arm went nowhere
    assert run.client["safety"] == (1 if wrong == "jump" else 0)
    if wrong == "jump":
        assert run.states[run.states.index("COMMANDING_ACTIVE") + 1] == "MONITORING_READY"
        assert run.report["stops"][0]["reason"] in run.complaints


def test_a_client_that_leaves_is_missed() -> None:
    quality = "the quality of the connection is"
    run = session(
        ("--wrong", "leave"),
        until=lambda robot: any(quality in visit.reason for visit in robot.visits),
        period_ms=4,
    )
    assert run.client_status == 0
    assert run.report["packets"]["lost"] > 10
    assert quality in json.dumps(run.report["states"])
    assert run.states[-1] == "IDLE"


@pytest.mark.slow("waits in real time")
def test_nobody_answers_and_the_controller_goes_on_until_it_is_interrupted() -> None:
    port = free_port()
    with process(*LIMO, "controller", "--client", f"127.0.0.1:{port}") as robot:
        assert robot.stdout is not None
        assert robot.stdout.readline().startswith("ready: FRI 1.15 from ")
        with pytest.raises(subprocess.TimeoutExpired):
            robot.wait(timeout=0.5)
        robot.send_signal(signal.SIGTERM)
        said, _ = robot.communicate(timeout=PATIENCE)
        assert robot.returncode == 0
    assert "nobody answered" in said
    assert "MONITORING_READY" not in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--fri", "1.12"), "FRI version '1.12' is not known"),
        (("--period-ms", "0"), "period_ms is 0 ms, expected a whole number from 1 to 100 ms"),
        (("--multiplier", "0"), "multiplier is 0, expected a whole number from 1 to 100"),
        (("--client", "30200"), "--client '30200' is no HOST:PORT"),
        (("--client", "127.0.0.1:99999"), "no HOST:PORT"),
        (("--bind", "192.0.2.1:0"), "cannot bind 192.0.2.1:0"),
        (("--position", "1,2"), "has to be 7 angles"),
        (("--position", "0,0,0,nan,0,0,0"), "joint 4: initial position nan rad is outside"),
        (("--trajectory", "none.parquet"), "none.parquet: cannot be read as a trajectory: no such"),
        (("--trajectory", "none.parquet", "--position", "0"), "not both"),
        (("--client", f"{'x' * 70}:30200"), "is not known"),
        (("--bind", "x" * 70), "cannot bind"),
        (("--late-ms", "inf"), "late_after is inf s, expected a number of 0 s or more"),
        (("--scenario", "none.yaml"), "none.yaml: cannot be read"),
    ],
)
def test_bad_options_are_one_clear_line(
    options: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from limo_driver.app import cli

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["limo", "controller", "--duration", "0.1", *options])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert ended.value.code == 2
    told = capsys.readouterr().err.strip()
    assert message in told
    assert len(told.splitlines()) == 1
