"""What a diagnosis writes of joints that slide: metres and newtons, in text, JSON and page."""

from __future__ import annotations

import json
import re
from functools import cache

import numpy as np
import pytest

from estimators.diagnosis import diagnose
from estimators.diagnosis.report.page import render
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.recordings.recording import Recording

RATE = 50.0  # [Hz]
_LINK = """<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="0 0 0.1"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>"""
_JOINT = """<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <axis xyz="{axis}"/><limit lower="-0.5" upper="0.5" velocity="1.5" effort="300"/></joint>"""
TURNING = re.compile(r"\bN(?: |&nbsp;|\N{NO-BREAK SPACE}|\\u00a0)m\b|\bm?rad\b")


def gantry(folder, last="prismatic"):
    """Write an arm of two joints, the first of which slides, and return its path."""
    parts = [_LINK.format(name="base", mass=5.0)]
    for parent, child, kind, axis in (("base", "lift", "prismatic", "0 0 1"),
                                      ("lift", "tool", last, "1 0 0")):  # fmt: skip
        parts.append(_LINK.format(name=child, mass=3.0))
        parts.append(_JOINT.format(child=child, kind=kind, parent=parent, axis=axis))
    path = folder / "gantry.urdf"
    path.write_text(f'<robot name="gantry">{"".join(parts)}</robot>')
    return str(path)


def recorded(simulation, seed):
    random, t = np.random.default_rng(seed), np.arange(int(40 * RATE)) / RATE
    pace, phase = random.uniform(0.4, 3.0, (3, 2)), random.uniform(0.0, 6.3, (3, 2))
    position = 0.1 * np.sin(pace * t[:, None, None] + phase).sum(axis=1)
    still = Recording.from_arrays(t, position, torque=np.zeros_like(position))
    torque = simulation.predict(still) + random.normal(scale=0.1, size=position.shape)
    return Recording.from_arrays(t, position, torque=torque)


def with_friction(robot, coulomb):
    effects = [f for j in (1, 2) for f in (CoulombFriction(joint=j, tau_c=coulomb),
                                           ViscousFriction(joint=j, f_v=8.0))]  # fmt: skip
    return Simulation(robot, effects=effects)


@cache
def found(folder, last):
    robot = gantry(folder, last)
    arm = with_friction(robot, 9.0)
    return diagnose(with_friction(robot, 4.0), [recorded(arm, 1)])


def written(result, page):
    """Return text, JSON and page of a diagnosis, without the programs of the page."""
    page = re.sub(r"<script>.*?</script>|<style>.*?</style>", "", page, flags=re.DOTALL)
    return {"text": str(result), "json": json.dumps(result.verdict.as_values()), "page": page,
            "table": str(list(result.figures()))}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gantry")


def test_nothing_of_a_gantry_is_told_in_radians(folder):
    result = found(folder, "prismatic")
    assert result.verdict.findings
    for name, text in written(result, render(result)).items():
        assert not TURNING.findall(text), (name, TURNING.search(text))
    assert result.verdict.fit.unit == "N"
    (value,) = {item.unit for item in result.verdict.values if item.name == "tau_c"}
    assert value == "N"


def test_joints_of_both_kinds_are_told_each_in_its_own_units(tmp_path):
    result = found(tmp_path, "revolute")
    units = {item.joints: item.unit for item in result.verdict.values if item.name == "tau_c"}
    assert units == {(1,): "N", (2,): "N m"}
    assert [result.verdict.unit_at(j) for j in (1, 2)] == ["N", "N m"]
    assert result.verdict.fit.unit == "N, N m"
    assert result.verdict.as_values()["sliding"] == [True, False]
    assert "position [m, rad]" in written(result, render(result))["page"]
    for item in result.verdict.findings:
        (j,) = item.joints
        assert TURNING.search(item.evidence) if j == 2 else not TURNING.search(item.evidence)
