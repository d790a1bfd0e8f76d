"""Documentation does what it says: its blocks run as written, in order, where a reader would be.

Each document has a folder of its own with `examples/` in it, and what a reader is said to have.
Blocks run in a network of their own, so that no arm or service of this machine answers.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from wandering import calm

import limo_driver as limo
from backends.can.config import ArmConfig
from backends.can.simulator.scenario import BusScenario
from backends.fri.simulator.scenario import ControllerScenario
from estimators.studies.sweep_trial import SweepSpace
from limo_driver.logs.readers import LogMapping
from limo_driver.physics import CoulombFriction, Payload, Simulation, ViscousFriction

ROOT = Path(__file__).parents[2]
LIMO = Path(__file__).with_name("short") / "limo"  # for a reader with little time
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
FENCE = re.compile(
    r"(?:^<!-- (?P<note>not run|beside): (?P<said>.+) -->\n)?"
    r"^```(?P<language>.*)\n(?P<text>(?:(?!```).*\n)*)```$",
    flags=re.MULTILINE,
)
PROGRAM = re.compile(
    r"^(limo [a-z]+ --[a-z-]+ \S|limo [a-z]+ \w+\.|python |make |pip )", flags=re.MULTILINE
)
RUNS = 4  # of a block whose arm holds since something came late
LATE = re.compile(  # why an arm holds that a busy machine makes hold
    r"limo: the arm holds \((?P<why>[^\n]*(?:command expired after|no measurement for"
    r"|has received none of the last|silent for|answer every packet| late)[^\n]*)"
)
LONGEST = 1200  # [s] that a block may take before something hangs
NOT_RUN = {
    "CONTRIBUTING.md": ["runs what runs this"],
    "README.md": ["installs limo, and runs what runs this"],
    "diagnosis.md": ["needs recordings of your arm"],
    "diagnosis_measured.md": [
        "takes hours",
        "needs finished verdicts",
        "needs recordings of a real arm",
    ],
    "embedding.md": ["needs minutes of free motion"],
    "first_motion.md": ["needs a real arm"],
    "fleet.md": ["needs a cluster"],
    "formats.md": ["part of a program of yours"],
    "fri.md": ["needs a real arm"],
    "reproduction.md": [
        "takes minutes to days",
        "takes hours, and recordings of real arms",
        "needs the authors' files",
    ],
    "ros2.md": ["needs a robot, and ends at Ctrl-C", "writes into a workspace of ROS"],
    "start.md": [
        *["installs limo, and runs what runs this"] * 3,
        "streams in real time, for minutes",
    ],
    "streaming.md": ["needs zenoh-pico, built in zenoh-pico/build", "needs two other machines"],
    "without_torque.md": ["needs a real arm"],
}
# A machine with one network, on which an address of the documents is this machine's.
NETWORK = """
ip link set lo up
ip link add net0 type veth peer name net1
ip addr add 192.168.1.5/24 dev net0
ip link set net1 up
ip link set net0 up
ip route add 224.0.0.0/4 dev net0
set -euo pipefail
"""
# The arm of a reader whose servos tell no torque.
SERVO_ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 0.1">
  <joint name="lift" axis="0 1 0" range="-1.5 1.5"/>
  <inertial pos="0.06 0 0" mass="0.2" diaginertia="2e-4 3e-4 3e-4"/>
  <body name="lower" pos="0.12 0 0"><joint name="bend" axis="0 1 0" range="-2 2"/>
    <inertial pos="0.05 0 0" mass="0.12" diaginertia="1e-4 2e-4 2e-4"/>
  </body></body></worldbody>
  <actuator><position joint="lift" kp="18" kv="0.6" forcerange="-3.3 3.3"/>
    <position joint="bend" kp="18" kv="0.6" forcerange="-3.3 3.3"/></actuator></mujoco>"""
ALONE = ["unshare", "--map-root-user", "--net", "--pid", "--fork", "--kill-child", "--mount-proc"]


@dataclass(frozen=True)
class Block:
    """A fenced block, and what the comment before it says."""

    document: str
    line: int
    language: str
    text: str
    not_run: str = ""
    beside: str = ""

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


def blocks(path):
    """Return the blocks of a document in order."""
    text = path.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        line = text.count("\n", 0, match.start("language")) + 1
        note = {(match["note"] or "").replace(" ", "_"): match["said"]} if match["note"] else {}
        found.append(Block(path.name, line, match["language"], match["text"], **note))
    return found


EVERY = [block for path in DOCUMENTS for block in blocks(path)]
RUNNABLE = ("sh", "python")


def test_every_block_is_found_and_has_a_language():
    fences = sum(path.read_text().count("\n```") for path in DOCUMENTS)
    assert fences == 2 * len(EVERY)
    assert {block.language for block in EVERY} == {"sh", "python", "yaml", "json", "text", "c"}


def test_text_holds_no_command():
    assert not [str(b) for b in EVERY if b.language == "text" and PROGRAM.search(b.text)]


def test_what_is_not_run_is_known_and_says_why():
    found = {}
    for block in EVERY:
        if block.not_run:
            found.setdefault(block.document, []).append(block.not_run)
    assert found == NOT_RUN


@pytest.mark.parametrize("block", [b for b in EVERY if b.language == "yaml"], ids=str)
def test_yaml_is_what_its_reader_reads(block, tmp_path):
    path = tmp_path / "block.yaml"
    path.write_text(block.text, encoding="utf-8")
    if block.document == "can.md":
        arm = ArmConfig.load(ROOT / "examples" / "can_cia402.yaml")
        assert BusScenario.load(path, arm.joints)
    elif block.document == "fri_controller.md":
        assert ControllerScenario.load(path)
    elif block.document == "your_data.md":
        assert LogMapping.load(path)
    elif block.document == "without_torque.md":
        (tmp_path / "arm.xml").write_text(SERVO_ARM, encoding="utf-8")
        assert Simulation.load(path).drives
    elif block.document == "estimators.md":
        assert len(SweepSpace.load(path).settings(10.0)) == 48  # 2 x 2 x 3 x 4 draws
    else:
        assert Simulation.load(path).effects


@pytest.mark.parametrize("block", [b for b in EVERY if b.language == "json"], ids=str)
def test_json_is_json(block):
    assert json.loads(block.text)


@pytest.mark.parametrize("block", [b for b in EVERY if b.language == "c"], ids=str)
def test_c_compiles_with_an_exported_header(block, tmp_path):
    arm = Simulation("iiwa14")
    limo.export_c(arm, tmp_path, 1000.0, free=[calm(arm, 1000.0, 12.0)])
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{tmp_path}"]
    (tmp_path / "block.c").write_text(block.text, encoding="utf-8")
    subprocess.run(["gcc", *flags, tmp_path / "block.c"], check=True)


def environment():
    """Return that of a reader who has installed limo, and has little time."""
    own = Path(sys.executable).parent
    path = os.pathsep.join([str(LIMO.parent), str(own), os.environ["PATH"]])
    found = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return os.environ | {
        "PATH": path,
        "PYTHONPATH": found,
        "LIMO": str(own / "limo"),
        "COLUMNS": "100",
    }


@pytest.fixture(scope="module")
def having(tmp_path_factory):
    """What readers are said to have: motions, recordings, a simulation, a model.

    Logs are of an arm whose joints have no memory, with a load on Wednesday, which is named soon:
    of joints that remember, a diagnosis takes a minute, and many documents have one.
    """
    folder = tmp_path_factory.mktemp("having")
    (folder / "examples").symlink_to(ROOT / "examples")
    simple = Simulation.load(ROOT / "examples" / "iiwa14_hysteretic.yaml")
    plain = (CoulombFriction, ViscousFriction)
    simple = replace(simple, effects=tuple(e for e in simple.effects if isinstance(e, plain)))
    simple.save(folder / "simple.yaml")
    load = Payload(mass=0.8, com=(0.02, 0.0, 0.08))
    replace(simple, effects=(*simple.effects, load)).save(folder / "loaded.yaml")
    script = """
    limo plan --seed 1 --out limo.traj.parquet
    limo plan --seed 2 --out other.traj.parquet
    run() { limo run --backend mujoco --trajectory "$1".traj.parquet --sim "$2" --record "$3"; }
    run limo examples/iiwa14_hysteretic.yaml run.parquet
    run other examples/iiwa14_hysteretic.yaml other.parquet
    run limo simple.yaml monday.parquet
    run other simple.yaml tuesday.parquet
    run other loaded.yaml wednesday.parquet
    run limo loaded.yaml thursday.parquet
    limo identify monday.parquet --robot iiwa14 --out sim.yaml
    limo train run.parquet --sim sim.yaml --model joint-physics --out model
    """
    done = subprocess.run(
        ["bash", "-ec", script], cwd=folder, env=environment(), capture_output=True, text=True,
        timeout=LONGEST, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (folder / "lossy.yaml").write_text(
        next(b.text for b in EVERY if (b.document, b.language) == ("fri_controller.md", "yaml"))
    )
    for day in ("monday", "tuesday", "wednesday", "thursday"):
        recorded = pq.read_table(folder / f"{day}.parquet")  # of a logger that knows no robot
        pq.write_table(recorded.replace_schema_metadata(None), folder / f"{day}.parquet")
    move_by_servos(folder)
    same = {
        "test.parquet": "other.parquet",
        "motion.traj.parquet": "limo.traj.parquet",
        "believed.yaml": "sim.yaml",
        "newer": "model",
        "arm.urdf": ROOT / "limo_driver" / "assets" / "iiwa14.urdf",
        "arm.yaml": ROOT / "examples" / "can_cia402.yaml",
    }
    for name, source in same.items():
        (folder / name).symlink_to(folder / source)
    return folder


def move_by_servos(folder):
    """Write the arm without torques, and what it recorded."""
    (folder / "arm.xml").write_text(SERVO_ARM, encoding="utf-8")
    friction = [CoulombFriction(joint=joint, tau_c=0.05) for joint in (1, 2)]
    arm = Simulation.load(folder / "arm.xml")
    arm = replace(arm, effects=(*arm.effects, *friction))
    time = np.arange(0.0, 20.0, 0.02)
    for name, pace in (("moves", 1.0), ("more_moves", 1.3)):
        slow, fast = (np.sin(pace * np.outer(time, rates)) for rates in ([0.9, 1.4], [2.1, 3.2]))
        command = 0.5 * (slow + fast)
        told = limo.Recording.from_arrays(time, command, command=command)
        moved = limo.predict_forward(arm, told)
        limo.Recording.from_arrays(time, moved, command=command).save(folder / f"{name}.parquet")


HAS = {  # a reader of each document; the rest comes from its own blocks
    "README.md": "monday.parquet tuesday.parquet wednesday.parquet thursday.parquet arm.urdf",
    "can.md": "arm.yaml sim.yaml motion.traj.parquet",
    "diagnosis.md": "monday.parquet tuesday.parquet sim.yaml run.parquet",
    "embedding.md": "run.parquet",
    "estimators.md": "run.parquet other.parquet sim.yaml",
    "fri_controller.md": "sim.yaml lossy.yaml",
    "models.md": "model newer run.parquet test.parquet",
    "streaming.md": "limo.traj.parquet model",
    "without_torque.md": "arm.xml moves.parquet more_moves.parquet",
    "workflow.md": "monday.parquet tuesday.parquet wednesday.parquet arm.urdf believed.yaml",
}

PRESS = re.compile(r" s: \[(?P<force>[^]]+)\] N,\n95 % within \[(?P<within>[^]]+)\] N\n")


def run(block, folder):
    """Run a block in a folder, with what runs beside it once that says something."""
    script = NETWORK
    if block.beside:
        script += f"{block.beside} > beside.txt &\nuntil [ -s beside.txt ]; do sleep 0.1; done\n"
    if block.language == "python":
        (folder / "block.py").write_text(block.text, encoding="utf-8")
        script += "python block.py\n"
    else:
        script += block.text
    return subprocess.run(
        [*ALONE, "bash", "-c", script], cwd=folder, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=LONGEST, check=False,
    )  # fmt: skip


class HeldWarning(UserWarning):
    """A block had to run again: nothing is wrong with one on a busy machine, but with many."""


def run_in_time(block, folder):
    """Run a block until no arm held for lack of time; return how it ended, and why arms held.

    On a machine too busy for real time a driver has to hold; its user runs it again. What holds for
    another reason would hold again, and is a failure.
    """
    held = []
    done = run(block, folder)
    while done.returncode and (late := LATE.search(done.stdout)) and len(held) + 1 < RUNS:
        held.append(late["why"])
        done = run(block, folder)
    return done, held


@pytest.mark.parametrize(
    ("said", "runs"),
    [
        ("the last command expired after 0.1 s); call resume()", RUNS),
        ("no measurement for 0.11 s); call resume()", RUNS),
        ("joint 2 is silent for 3 cycles); call resume()", RUNS),
        ("a safety stop is in force (EXTERNAL)); call resume()", 1),
    ],
)
def test_only_what_holds_for_lack_of_time_is_run_again(said, runs, monkeypatch):
    text = f"limo: the arm holds ({said} before the next command\n"
    ended = subprocess.CompletedProcess([], 2, stdout=text)
    monkeypatch.setitem(globals(), "run", lambda *_: ended)
    _, held = run_in_time(None, None)
    assert len(held) + 1 == runs


@pytest.fixture
def reader(having, tmp_path):
    """Make a function that returns the folder of a document's reader."""
    able = subprocess.run([*ALONE, "true"], capture_output=True, text=True, check=False)
    if able.returncode:
        pytest.skip(f"no network of its own is to be had: {able.stderr.strip()}")

    def of(document):
        (tmp_path / "examples").symlink_to(ROOT / "examples")
        for name in HAS.get(document, "").split():
            source = having / name
            copied = shutil.copytree if source.is_dir() else shutil.copy
            copied(source, tmp_path / name)
        return tmp_path

    return of


TO_RUN = {
    path.name: [b for b in blocks(path) if b.language in RUNNABLE and not b.not_run]
    for path in DOCUMENTS
}


@pytest.mark.slow("plans, moves, learns, diagnoses and serves, as the documents do")
@pytest.mark.filterwarnings("default:.* ran .* times, since the arm held")
@pytest.mark.parametrize("document", [name for name, found in TO_RUN.items() if found])
def test_a_document_does_what_it_says(document, reader):
    folder, printed = reader(document), ""
    for block in TO_RUN[document]:
        done, held = run_in_time(block, folder)
        if held:
            listed = "\n".join(held)
            told = f"{block} ran {len(held) + 1} times, since the arm held:\n{listed}"
            warnings.warn(told, HeldWarning, stacklevel=1)
        assert done.returncode == 0, f"{block}:\n{done.stdout}"
        assert "Traceback" not in done.stdout, f"{block}:\n{done.stdout}"
        printed += done.stdout
    if document == "ultrasound.md":
        assert re.search(r"false alarms: 1 an hour: --contact [\d.,]+ \[N m\]", printed), printed
        pressed = PRESS.search(printed)
        assert pressed, printed
        force, within = (np.array(known.split(), float) for known in pressed.groups())
        off = np.abs(force - [0.0, 0.0, 15.0])  # [N], what the page presses with
        assert (off < 2.0 * within).all() and within.max() < 5.0, printed  # noqa: PT018


def test_a_reader_with_little_time_plans_little_and_watches_shortly(tmp_path):
    real = tmp_path / "limo"
    real.write_text('#!/bin/sh\necho "$@"\n')
    real.chmod(0o755)

    def asked(*words):
        return subprocess.check_output([LIMO, *words], env={"LIMO": str(real)}, text=True).split()

    assert asked("plan", "--out", "a") == ["plan", "--out", "a", "--scaffolds", "1"]
    assert asked("watch", "--web") == ["watch", "--web", "--duration", "5"]
    assert asked("watch", "--until", "serving") == ["watch", "--until", "serving"]
    assert asked("run", "--record", "plan") == ["run", "--record", "plan"]
