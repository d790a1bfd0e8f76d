"""`limo doctor` from the command line: the examination of a bus, and the steps."""

import json

import pytest
from arms import virtual_bus
from first_motions import NODES, CanBench
from ports import free_port

ARM = """
bus: {{interface: virtual, channel: {channel}}}
robot: iiwa14
rate: 100
watchdog: 1.0
answer_timeout: 0.1
temperature: {{object: 0x2031}}
joints:
"""
JOINT = "  - {{node: {node}, counts_per_turn: 524288, rated_torque: 320}}\n"


@pytest.fixture
def arm_yaml(tmp_path):
    path = tmp_path / "arm.yaml"
    text = ARM.format(channel=virtual_bus().channel)
    path.write_text(text + "".join(JOINT.format(node=node) for node in NODES))
    return path


@pytest.fixture
def bench(monkeypatch):
    return CanBench().plug(monkeypatch)


def test_a_bus_is_examined_without_power_or_records(limo, bench, arm_yaml, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = limo("doctor", "can", "--config", arm_yaml, "--seconds", 0.2)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.endswith("the link works\n")
    assert bench.set_points == []
    assert [path.name for path in tmp_path.iterdir()] == ["arm.yaml"]


def test_a_bus_without_drives_is_named_and_ends_with_one(limo, arm_yaml):
    ended = limo("doctor", "can", "--config", arm_yaml, "--json")
    assert ended.returncode == 1
    (finding,) = json.loads(ended.stdout)["findings"]
    assert finding["code"] == "bus"
    assert "no drive answers" in finding["text"]


def test_the_next_step_is_taken_and_one_too_far_is_refused(limo, bench, arm_yaml, tmp_path):
    out = tmp_path / "kept"
    given = ("doctor", "can", "--config", arm_yaml, "--robot", "iiwa14", "--out", out)
    ended = limo(*given, "--step", "limopa")
    assert ended.returncode == 2
    (line,) = ended.stderr.strip().splitlines()
    assert "step 5 (LIMOPA) is refused, and nothing moves: step 1 (link and versions)" in line
    assert "was skipped" in line
    ended = limo(*given, "--seconds", 0.2)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == f"link: passed; {out / '1_link.html'}"
    ended = limo(*given, "--seconds", 0.5, "--json")
    assert ended.returncode == 1
    told = json.loads(ended.stdout)
    assert told["step"] == "receive"
    assert [each["code"] for each in told["findings"] if each["problem"]] == ["poses"]
    assert bench.set_points == []


def test_records_of_another_description_do_not_count(limo, bench, arm_yaml, tmp_path):
    out, sim = tmp_path / "kept", tmp_path / "sim.yaml"
    sim.write_text("robot: iiwa14\neffects:\n  - {effect: payload, mass: 2.0, com: [0, 0, 0.1]}\n")
    given = ("doctor", "can", "--config", arm_yaml, "--out", out)
    assert limo(*given, "--robot", "iiwa14", "--seconds", 0.2).returncode == 0
    ended = limo(*given, "--sim", sim, "--step", "receive")
    assert ended.returncode == 2
    assert "with another description of the arm" in ended.stderr
    assert bench.set_points == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--robot", "iiwa14", "--sim", "x.yaml"), "give --sim or --robot"),
        (("--robot", "iiwa14", "--minutes", "1", "--seconds", "1"), "not both"),
        (("--robot", "iiwa14", "--minutes", "0"), "--minutes is 0"),
        (("--robot", "iiwa14", "--joint", "8"), "is 8, expected 1 to 7"),
        (("--robot", "nowhere.urdf"), "neither built in"),
    ],
)
def test_options_that_do_not_go_together_are_refused_in_one_line(
    limo, arm_yaml, tmp_path, options, said
):
    ended = limo("doctor", "can", "--config", arm_yaml, "--out", tmp_path / "kept", *options)
    assert ended.returncode == 2
    (line,) = ended.stderr.strip().splitlines()
    assert said in line


def test_another_description_than_that_of_the_drives_is_refused(limo, arm_yaml, two_links_urdf):
    ended = limo("doctor", "can", "--config", arm_yaml, "--robot", two_links_urdf)
    assert ended.returncode == 2
    assert "another description was given" in ended.stderr


@pytest.mark.waits
def test_an_iiwa_that_does_not_speak_keeps_the_status_of_the_examination(limo, tmp_path):
    ended = limo(
        "doctor", "fri", "--robot", "iiwa14", "--port", free_port(), "--seconds", 0.1,
        "--out", tmp_path / "kept",
    )  # fmt: skip
    assert ended.returncode == 3
    assert "problem: nobody: " in ended.stdout
    assert json.loads((tmp_path / "kept" / "1_link.json").read_text())["verdict"] == "failed"
