"""The ROS 2 package: compiles against stubs of what it uses, and computes what Python does."""

from __future__ import annotations

import ast
import shutil
import subprocess
import xml.etree.ElementTree as ET  # of files that limo wrote
from pathlib import Path

import numpy as np
import pytest
import yaml

from estimators.embedded.ros2_package import export_ros2
from limo_driver.errors import ConfigError
from limo_driver.model.kinematics import FlangeWrench
from limo_driver.physics import CoulombFriction, Simulation

HERE = Path(__file__).parent
STRICT = ["-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{HERE / 'stubs'}"]
TAU_C = 0.7  # [N m]
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")


@pytest.fixture(scope="module")
def arm():
    return Simulation("iiwa14", (CoulombFriction(joint=2, tau_c=TAU_C, v_eps=1e-4),))


@pytest.fixture(scope="module")
def package(arm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("package")
    export_ros2(arm, folder, 1000.0)
    return folder


def run(*command, **options):
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_compiler
def test_the_controller_compiles(package):
    run("g++", *STRICT, "-fsyntax-only", package / "src" / "wrench_broadcaster.cpp")


@needs_compiler
def test_solver_and_wrench_are_those_of_python(arm, package, tmp_path):
    run("gcc", "-std=c11", "-c", package / "src" / "limo.c", "-o", tmp_path / "limo.o")
    sources = HERE / "ros2_driver.cpp", tmp_path / "limo.o"
    run("g++", *STRICT, f"-I{package / 'src'}", *sources, "-o", tmp_path / "driver")
    random, model = np.random.default_rng(3), arm.model
    q, v, a, external = random.uniform(-1.0, 1.0, (4, 7))
    std = random.uniform(0.1, 1.0, 7)
    text = " ".join(f"{x:.17g}" for x in np.concatenate([q, v, a, external, std]))
    *lines, unlike, refused = run(tmp_path / "driver", input=text).splitlines()
    M, C, G, torque, friction, wrench = (np.array(line.split(), float) for line in lines)
    zero, rows = np.zeros(7), [np.atleast_2d(x) for x in (q, v, a)]
    gravity = model.gravity_torque(rows[0])[0]
    moving = model.inverse_dynamics(rows[0], rows[1], np.atleast_2d(zero))[0]
    np.testing.assert_allclose(M.reshape(7, 7), model.mass_matrix(q), atol=1e-9)
    np.testing.assert_allclose(G, gravity, atol=1e-9)
    np.testing.assert_allclose(C, moving - gravity, atol=1e-9)
    np.testing.assert_allclose(torque, model.inverse_dynamics(*rows)[0], atol=1e-9)
    np.testing.assert_allclose(friction, TAU_C * np.sign(v) * (np.arange(7) == 1), atol=1e-3)
    expected = FlangeWrench(model).of(q, external, std).value
    np.testing.assert_allclose(wrench, expected, rtol=1e-9, atol=1e-9)
    assert unlike.startswith("the joints are a, and the model is of joint1, joint2")
    assert refused == "robot_description has no joint joint1: the model is of another robot"


@pytest.mark.parametrize("name", ["limo", "left"])
def test_every_name_begins_with_that_of_the_package(arm, tmp_path, name):
    export_ros2(arm, tmp_path, 1000.0, name=name)
    for file in ("package.xml", "wrench_broadcaster.xml", "inverse_dynamics.xml"):
        text = (tmp_path / file).read_text()
        ET.fromstring(text)  # noqa: S314
        assert f"{name}_" in text
        assert name == "limo" or "limo_" not in text
    about = yaml.safe_load((tmp_path / "config" / "wrench_broadcaster.yaml").read_text())
    parameters = about[f"{name}_wrench_broadcaster"]["ros__parameters"]
    assert parameters["type"] == f"{name}_dynamics/WrenchBroadcaster"
    assert parameters["joints"] == list(arm.model.joint_names)
    assert parameters["frame_id"] == "flange"
    ast.parse((tmp_path / "launch" / "wrench_broadcaster.launch.py").read_text())
    assert {path.name for path in (tmp_path / "src").iterdir()} == {
        f"{name}.c", f"{name}.h", "arm.hpp", "inverse_dynamics.cpp", "wrench_broadcaster.cpp",
    }  # fmt: skip


def test_a_frame_that_does_not_exist_is_refused_before_anything_is_written(arm, tmp_path):
    with pytest.raises(ConfigError, match=r"no frame 'tool0' .* one of link7, flange$"):
        export_ros2(arm, tmp_path / "none", 1000.0, frame="tool0")
    assert not (tmp_path / "none").exists()


def test_a_frame_is_of_no_other_export(limo, tmp_path):
    done = limo("export", "x.yaml", "--to", "c", "--wrench-frame", "tool0", "--out", tmp_path)
    assert done.returncode == 2
    assert done.stderr == "limo: --wrench-frame is of --to ros2, not of --to c\n"
