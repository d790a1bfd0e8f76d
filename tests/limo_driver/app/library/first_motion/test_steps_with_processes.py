"""The first steps of `limo doctor` with the other end in a process of its own, on a real link.

A busy machine makes measurements late, and that is named, rightly; so nothing here depends on it:
the link counts as passed where only lateness is named, and hands guide the arm again and again.
"""

import json
import subprocess
import sys
from contextlib import contextmanager

import pytest
import yaml
from bus_master import GROUP
from first_motions import POSES, START
from ports import free_port

from backends.can.config import CONVENTIONS, ArmConfig
from limo_driver.app.library.first_motion.arms import CanArm, FriArm
from limo_driver.app.library.first_motion.gravity import NO_TORQUE
from limo_driver.app.library.first_motion.records import Folder, Identity, description_digest
from limo_driver.model import RobotModel
from limo_driver.robot.registry import Examination

pytestmark = [
    pytest.mark.waits,
    pytest.mark.slow("starts a process, and receives for a quarter of a minute"),
]

LATE = {"late", "loss", "jitter", "loose-cable", "torque"}  # arms jerk after a hand they missed
SECONDS = 14.0  # for three poses, wherever the hand is when it begins
EVERY, LONG = 3.5, 0.8  # [s] from hand to hand, and of each
TOOL = "robot: iiwa14\neffects:\n  - {effect: payload, mass: 4.0, com: [0.0, 0.0, 0.12]}\n"
MAIN = "from limo_driver.app.cli import main; main()"
JOINTS = {
    "cia402": "{{node: {node}, counts_per_turn: 524288, rated_torque: 320}}",
    "damiao": "{{node: {node}, stiffness: 500, damping: 5}}",
}


@contextmanager
def other_end(*given):
    """Run a command of limo from when it says that it is ready until the block ends."""
    command = [sys.executable, "-c", MAIN, *map(str, given), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert json.loads(process.stdout.readline())["ready"]
            yield
        finally:
            process.terminate()


def hands(length, file, **more):
    """Write a scenario in which the arm is guided from pose to pose for five minutes."""
    poses = (START, *POSES)
    guides = [
        {"at": EVERY * k, length: LONG, "position": list(poses[k % len(poses)])}
        for k in range(1, 86)
    ]
    kind, name = ("fault", "faults") if length == "lasts" else ("event", "events")
    events = [{kind: "guide", **guide} for guide in guides]
    file.write_text(yaml.safe_dump({**more, name: [*more.get(name, ()), *events]}))
    return file


def taken(limo, *given):
    """Take a step; return its findings, problems and notes, by their kinds."""
    ended = limo("doctor", *given, "--json")
    assert ended.stdout, ended.stderr
    found = json.loads(ended.stdout)["findings"]
    return tuple({f["code"]: f["text"] for f in found if f["problem"] is p} for p in (True, False))


def receive(limo, arm, out, *given):
    """Take the first two steps; return what the second found."""
    problems, _ = taken(limo, *given, "--out", out, "--seconds", 2.0)
    assert set(problems) <= LATE
    mine = Identity(arm.model.name, description_digest(arm.model), arm.address)
    Folder(out).keep("link", mine, Examination(), {})
    return taken(limo, *given, "--out", out, "--step", "receive", "--seconds", SECONDS)


def judge(problems, notes, tool, *, powered=True):
    if not powered:  # drives that compute torque from current have none yet
        assert "before a joint moves" in notes[NO_TORQUE]
    elif tool:
        assert "kg more than described" in problems.pop("tool-mass")
    else:
        assert "poses are gravity" in notes["gravity"]
    assert set(problems) <= LATE


@pytest.mark.parametrize("tool", [False, True], ids=["as described", "with a tool"])
def test_an_iiwa_behind_its_controller(limo, tmp_path, tool):
    port, sim = free_port(), tmp_path / "sim.yaml"
    sim.write_text(TOOL if tool else "robot: iiwa14\n")
    cap = {"event": "session", "at": 0.0, "for": 1e6, "state": "monitoring_ready"}
    scenario = hands("for", tmp_path / "hands.yaml", events=[cap])
    given = ("--client", f"127.0.0.1:{port}", "--sim", sim, "--scenario", scenario)
    at = ",".join(map(str, START))
    with other_end("controller", *given, "--period-ms", 10, f"--position={at}"):
        arm = FriArm(RobotModel.load("iiwa14"), (), "127.0.0.1", port)
        doctor = ("fri", "--host", "127.0.0.1", "--port", port, "--robot", "iiwa14")
        judge(*receive(limo, arm, tmp_path / "kept", *doctor), tool)


@pytest.mark.parametrize("tool", [False, True], ids=["as described", "with a tool"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_drives_on_a_bus(limo, tmp_path, convention, tool):
    file, sim = tmp_path / "arm.yaml", tmp_path / "sim.yaml"
    sim.write_text(TOOL if tool else "robot: iiwa14\n")
    joints = "".join(f"  - {JOINTS[convention].format(node=node)}\n" for node in range(11, 18))
    file.write_text(
        f"bus: {{interface: udp_multicast, channel: {GROUP}, "
        f"options: {{port: {free_port()}, hop_limit: 0}}}}\nconvention: {convention}\n"
        f"robot: iiwa14\nrate: 100\nwatchdog: 2.0\nanswer_timeout: 5.0\njoints:\n{joints}"
    )
    scenario = hands("lasts", tmp_path / "hands.yaml", **{"from": "start"})
    with other_end("drives", "--config", file, "--sim", sim, "--scenario", scenario):
        arm = CanArm(RobotModel.load("iiwa14"), (), ArmConfig.load(file), file)
        doctor = ("can", "--config", file, "--robot", "iiwa14")
        found = receive(limo, arm, tmp_path / "kept", *doctor)
        judge(*found, tool, powered=convention != "damiao")
