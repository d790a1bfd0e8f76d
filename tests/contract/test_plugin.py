"""What another distribution adds is used as what is limo's own: by every command, by its name.

The distribution is `plugin/`; here it is put beside its metadata, as an installer would.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml
from processes import ARM, PATIENCE, Answers, Network, driven, limo, served

from limo_driver.network.streaming import open_session
from limo_driver.trajectory import Trajectory

pytestmark = pytest.mark.waits

PLUGIN = Path(__file__).parent / "plugin"
FRICTION = [
    {"effect": "coulomb_friction", "joint": joint, "tau_c": 0.4, "v_eps": 0.01} for joint in (1, 2)
]
CABLE = {"effect": "taut_cable", "joint": 2, "stiffness": 6.0, "taut_from": -0.7}
NOISE = 0.01  # [N m]


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Where processes find the distribution."""
    site = tmp_path_factory.mktemp("site")
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())["project"]
    shutil.copytree(PLUGIN / "limo_cable", site / "limo_cable")
    about = site / f"limo_cable-{project['version']}.dist-info"
    about.mkdir()
    named = f"Name: {project['name']}\nVersion: {project['version']}\n"
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\n{named}")
    groups = (
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
        for group, entries in project["entry-points"].items()
    )
    (about / "entry_points.txt").write_text("\n".join(groups))
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "120"}


@pytest.fixture(scope="module")
def command(environment):
    """Run a command in a process of its own, to its end; return what it printed."""

    def run(*arguments):
        done = subprocess.run(
            limo(*arguments),
            env=environment, capture_output=True, text=True, timeout=600, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory, two_links_urdf):
    """An arm, a motion that turns both of its joints, and the arm with and without its cable."""
    folder = tmp_path_factory.mktemp("arm")
    shutil.copy(two_links_urdf, folder / "two_links.urdf")
    t = np.arange(0.0, 40.0, 0.005)[:, None]
    turns = np.array([[0.25, 0.41], [0.31, 0.19]]) * 2 * np.pi  # [rad/s]
    sizes = np.array([[0.3, 0.2], [0.4, 0.2]])  # [rad]
    rising = 0.5 * (1.0 - np.cos(np.pi * np.clip(np.minimum(t, t[-1] - t) / 2.0, 0.0, 1.0)))
    swing = sum(sizes[:, k] * np.sin(turns[:, k] * t) for k in (0, 1))
    position = np.array([0.4, -0.8]) + rising * swing
    velocity = np.gradient(position, t[:, 0], axis=0)
    acceleration = np.gradient(velocity, t[:, 0], axis=0)
    Trajectory(t[:, 0], position, velocity, acceleration, robot="two_links").save(
        folder / "motion.traj.parquet"
    )
    known = {"robot": "two_links.urdf", "sensors": {"torque_noise": [NOISE]}}
    for name, effects in (("given", FRICTION), ("true", [*FRICTION, CABLE])):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(known | {"effects": effects}))
    return folder


@pytest.fixture(scope="module")
def recording(folder, command):
    """The arm with its cable, run on MuJoCo."""
    command(
        "run", "--backend", "mujoco", "--trajectory", folder / "motion.traj.parquet",
        "--sim", folder / "true.yaml", "--rate", "200", "--record", folder / "run.parquet",
    )  # fmt: skip
    return folder / "run.parquet"


def test_the_documentation_shows_this_distribution():
    page = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text()
    shown = page.split("```text\n")[1].split("```")[0]
    assert shown.strip() in (PLUGIN / "pyproject.toml").read_text()
    effect = page.split("class TautCable")[1].split("\n\n\n")[0]
    own = (PLUGIN / "limo_cable" / "taut_cable.py").read_text()
    assert set(effect.splitlines()) <= set(own.split("class TautCable")[1].splitlines())


@pytest.mark.slow("commands in processes of their own: a run, and a whole diagnosis")
def test_an_effect_is_run_concealed_and_named(folder, recording, command):
    out = folder / "diagnosis"
    command("diagnose", recording, "--sim", folder / "given.yaml", "--out", out)
    (found,) = json.loads((out / "verdict.json").read_text())["findings"]
    assert (found["effect"], found["kind"], found["joints"]) == ("taut_cable", "missing", [2])
    assert "torque sets in at one position, and grows beyond it" in found["evidence"]
    for name in ("stiffness", "taut_from"):
        (low, high), value = found["parameters"][name]["ci95"], CABLE[name]
        assert low < value < high or found["parameters"][name]["value"] == pytest.approx(
            value, rel=0.02
        )
    page = (out / "report.html").read_text()
    assert "Taut cable" in page
    better = yaml.safe_load((out / "sim.yaml").read_text())
    assert "taut_cable" in {effect["effect"] for effect in better["effects"]}
    command("predict", recording, "--sim", out / "sim.yaml", "--out", folder / "torque.parquet")


@pytest.mark.slow("commands in processes of their own, one of them a service")
def test_an_estimator_is_trained_evaluated_and_served(
    folder, recording, command, environment, tmp_path
):
    model, known = folder / "model", folder / "given.yaml"
    command("train", recording, "--sim", known, "--model", "joint-waves", "--out", model)
    assert json.loads((model / "manifest.json").read_text())["estimator"] == "joint-waves"
    said = command("evaluate", recording, "--model", model, "--out", tmp_path / "e", "--json")
    errors = json.loads(said)
    assert errors["rmse_hybrid"][1] < 0.5 * errors["rmse_rigid_body"][1]
    command("predict", recording, "--model", model, "--out", tmp_path / "torque.parquet")
    network = Network(tmp_path)
    with (
        open_session(config=network.here) as session,
        served(network, "--arm", ARM, "--model", model, env=environment) as service,
        driven(session),
    ):
        answers = Answers(session)
        answers.later()
        assert set(answers.models) == {"model"}
        service.terminate()
        service.wait(PATIENCE)
