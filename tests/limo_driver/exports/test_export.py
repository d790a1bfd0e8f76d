"""Export: the user's own file with what was found, read by a simulator that knows no limo."""

import difflib
import json
import re
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mjcf_arms import arm_of, plain, torques

import limo_driver as limo
from limo_driver.app.cli import main
from limo_driver.errors import ConfigError
from limo_driver.exports.export import Export, write
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    CoulombFriction,
    GravityDirection,
    Payload,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    SpringLoad,
    StribeckFriction,
    TorqueOffset,
    ViscousFriction,
)
from limo_driver.types import Motion


def found_on(simulation, seed=0):
    """A simulation with changes of every kind that MJCF can hold."""
    random = np.random.default_rng(seed)
    inertials = {
        link: replace(
            body,
            mass=body.mass * random.uniform(0.8, 1.3),
            com=tuple((np.array(body.com) + random.normal(0, 0.01, 3)).tolist()),
        )
        for link, body in simulation.model.inertials.items()
    }
    effects = [
        Payload(mass=0.8, com=(0.01, 0.02, 0.05), inertia=(0.002, 0, 0, 0.002, 0, 0.001)),
        GravityDirection(gravity=(0.1, -0.5, -9.75)),
    ]
    for joint in range(1, simulation.model.n + 1):
        effects += [
            CoulombFriction(joint=joint, tau_c=random.uniform(0.2, 1.5), v_eps=0.003),
            ViscousFriction(joint=joint, f_v=random.uniform(0.1, 2)),
            QuadraticDrag(joint=joint, coefficient=random.uniform(0, 0.5)),
            Armature(joint=joint, inertia=random.uniform(0.01, 0.2)),
            SpringLoad(joint=joint, stiffness=random.uniform(-1, 3), rest=0.3, cubic=0.4),
        ]
    return replace(simulation, inertials=inertials, effects=tuple(effects))


FIRMEST = ['solimpfriction="0.9999 0.9999"', 'solreffriction="0.002 1"']


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(arm_of(3), encoding="utf-8")
    return path


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(1, 6), inertials=st.booleans())
def test_to_limo_and_back_nothing_changes(tmp_path_factory, seed, joints, inertials):
    folder = tmp_path_factory.mktemp("arm")
    path = folder / "model.xml"
    path.write_text(arm_of(seed, joints, inertials=inertials), encoding="utf-8")
    written = limo.export(Simulation.load(path), "mjcf", folder / "out")
    assert written.diff == ""
    assert written.file.read_bytes() == path.read_bytes()


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(1, 6))
def test_a_plain_simulator_has_what_was_found(tmp_path_factory, seed, joints):
    folder = tmp_path_factory.mktemp("arm")
    path = folder / "model.xml"
    path.write_text(arm_of(seed, joints), encoding="utf-8")
    simulation = found_on(Simulation.load(path), seed % 1000)
    written = limo.export(simulation, "mjcf", folder / "out")
    assert written.remainder == ()
    assert written.share < 0.01
    # ... and once more, by nothing but MuJoCo and the prediction, away from standstill
    q, a = np.random.default_rng(1).uniform(-1, 1, (2, 30, joints))
    v = np.random.default_rng(2).choice([-0.6, 0.4], (30, joints))
    expected = simulation.predict(Motion(np.arange(30.0), q, v, a))
    mine = torques(plain(mujoco.MjModel.from_xml_path(str(written.file))), q, v, a)
    np.testing.assert_allclose(mine, expected, atol=5e-3 * np.abs(expected).max())


def test_only_lines_of_what_was_found_change(model, tmp_path):
    simulation = Simulation.load(model)
    with_more = replace(
        simulation, effects=(*simulation.effects, CoulombFriction(joint=1, tau_c=0.9, v_eps=0.01))
    )
    written = limo.export(with_more, "mjcf", tmp_path / "out")
    before, after = model.read_text().splitlines(), written.file.read_text().splitlines()
    changed = [line for line in difflib.ndiff(before, after) if line[:2] in {"- ", "+ "}]
    assert len(changed) == 3
    assert "<!-- limo wrote: " in changed[2]
    assert 'frictionloss="0.9"' in changed[1]
    assert 'name="hinge0"' in changed[1]
    assert "<!-- kept as it is -->" in written.file.read_text()
    assert model.read_text() == arm_of(3)


@pytest.mark.slow("writes a file, and has MuJoCo prove it")
def test_what_is_not_expressible_is_said_with_its_size(model, tmp_path):
    bare = replace(Simulation.load(model), effects=())
    effects = (
        StribeckFriction(joint=1, tau_s=0.8, v_s=0.2, delta=1.0),
        TorqueOffset(joint=2, offset=0.3),
        PreslidingHysteresis(joint=3, stiffness=(40.0, 10.0), width=(0.01, 0.05)),
        AsymmetricFriction(joint=4, tau_plus=1.2, tau_minus=0.8, v_eps=0.01),
    )
    simulation = replace(bare, effects=effects)
    written = limo.export(simulation, "mjcf", tmp_path / "out", mujoco=3)
    said = {item.place: str(item) for item in written.remainder}
    offset = said["torque_offset, joint 2"]
    assert offset == ("torque_offset, joint 2 is not expressible: 0.3 N m RMS remain (joint 2)")
    assert "is not expressible" in said["stribeck_friction, joint 1"]
    assert "is written as LuGre friction" in said["presliding_hysteresis, joint 3"]
    sizes = {item.place: max(item.rms) for item in written.remainder}
    assert sizes["asymmetric_friction, joint 4"] == pytest.approx(0.2, rel=0.02)
    assert 1e-4 < sizes["presliding_hysteresis, joint 3"] < 0.05
    assert ", less what is left, to " in written.headline()
    assert written.left == written.remainder
    none = replace(written.remainder[0], rms=(0.0,) * len(written.torque))
    quiet = replace(written, remainder=(none,))
    assert quiet.left == ()
    assert "left" not in quiet.headline().removeprefix(str(quiet.file))
    text = written.file.read_text()
    assert " 0 0.9 0.9 " in text  # 40 · 0.01 + 10 · 0.05
    assert 'frictionloss="1"' in text


def test_an_armature_that_is_none_is_expressed_by_leaving_it_out(model, tmp_path):
    effects = (Armature(joint=1, inertia=0.1), Armature(joint=2, inertia=0.0))
    simulation = replace(Simulation.load(model), effects=effects)
    left = [item.place for item in limo.export(simulation, "urdf", tmp_path / "out").remainder]
    assert "armature, joint 1" in left
    assert "armature, joint 2" not in left


def test_a_urdf_has_friction_damping_inertias_and_payload(tmp_path):
    simulation = found_on(Simulation("iiwa14"))
    written = limo.export(simulation, "urdf", tmp_path / "out")
    assert written.share < 0.01
    places = {item.place.partition(",")[0] for item in written.remainder}
    assert places >= {"armature", "spring_load", "quadratic_drag", "gravity (0.1"}
    assert "<!--\nKUKA LBR iiwa 14 R820, written for limo." in written.file.read_text()
    again = Simulation.load(written.file)
    assert again.model.inertials["link7"].mass == pytest.approx(
        simulation.body.inertials["link7"].mass
    )
    assert again.effects[0].tau_c == pytest.approx(simulation.effects[2].tau_c)


def test_gravity_that_a_urdf_has_no_place_for_is_told_with_its_torque(two_links_urdf, tmp_path):
    tilted, level = (
        Simulation(str(two_links_urdf), (GravityDirection(gravity=gravity),))
        for gravity in ((3.0, 0.0, -9.0), (0.0, 0.0, -9.81))
    )
    poses = np.random.default_rng(2).uniform(-1.0, 1.0, (50, 2))
    still = Motion(np.arange(50.0), poses, np.zeros((50, 2)), np.zeros((50, 2)))
    written = write(tilted, two_links_urdf, "urdf", tmp_path, still)
    (change,) = (item for item in written.remainder if "gravity" in item.place)
    by_joint = np.sqrt(np.mean((tilted.predict(still) - level.predict(still)) ** 2, axis=0))
    assert change.rms == pytest.approx(tuple(by_joint))


def test_the_share_is_of_the_torque_of_all_joints_together(tmp_path):
    export = Export(tmp_path, (), "mjcf", "", (), ("a", "b"), error=(0.3, 0.4), torque=(5.0, 0.0))
    assert export.share == pytest.approx(0.1)
    assert "to 10.00% of the torque" in export.headline()
    assert replace(export, torque=(0.0, 0.0)).share == 0.0


def test_dry_friction_of_a_light_joint_is_made_firm_by_as_much_as_it_needs(model, tmp_path):
    for tau_c, firm in ((0.1, []), (10.0, ['solimpfriction="0.999 0.999"']), (200.0, FIRMEST)):
        effects = (CoulombFriction(joint=4, tau_c=tau_c, v_eps=0.003),)
        found = replace(Simulation.load(model), effects=effects)
        written = limo.export(found, "mjcf", tmp_path / f"{tau_c:g}")
        assert written.share < 0.01
        assert re.findall(r'sol\w+="[^"]*"', written.file.read_text()) == firm


def test_a_robot_of_another_format_gets_a_bare_file(tmp_path):
    written = limo.export(found_on(Simulation("iiwa14")), "mjcf", tmp_path / "out")
    assert written.file.name == "iiwa14.xml"
    assert written.share < 0.01
    again = limo.RobotModel.load(written.file)
    assert again.joint_names == tuple(f"joint{j}" for j in range(1, 8))
    added = 'frictionloss="[^"]*" armature="[^"]*" damping="[^"]*" stiffness="[^"]*" springref='
    assert len(re.findall(added, written.file.read_text())) == 7, "each time in this order"


def test_into_another_file_of_the_same_arm(model, tmp_path):
    """The file on disk has other inertias than the robot that was identified."""
    other = tmp_path / "other"
    other.mkdir()
    text = model.read_text().replace('mass="', 'mass="1')  # ten kilograms and more
    (other / "scene.xml").write_text(text)
    simulation = found_on(Simulation.load(model))
    written = limo.export(simulation, "mjcf", tmp_path / "out", into=other / "scene.xml")
    assert written.share < 0.01


def test_includes_and_meshes_come_along(tmp_path):
    folder = tmp_path / "model"
    (folder / "meshes").mkdir(parents=True)
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype="<f4")
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    stl = bytes(80) + np.uint32(4).tobytes()
    for face in faces:
        stl += np.zeros(3, "<f4").tobytes() + corners[list(face)].tobytes() + bytes(2)
    (folder / "meshes" / "link.stl").write_bytes(stl)
    (folder / "arm.xml").write_text(
        '<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0" range="-90 90"/>'
        '<geom type="mesh" mesh="link" density="2000"/></body></worldbody></mujoco>'
    )
    (folder / "scene.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh name="link" file="link.stl"/></asset>'
        '<include file="arm.xml"/></mujoco>'
    )
    simulation = replace(
        Simulation.load(folder / "scene.xml"),
        effects=(SpringLoad(joint=1, stiffness=2.0, rest=0.5),),
    )
    written = limo.export(simulation, "mjcf", tmp_path / "out")
    names = sorted(str(path.relative_to(tmp_path / "out")) for path in written.files)
    assert names == ["arm.xml", "meshes/link.stl", "scene.xml"]
    assert 'springref="28.64788976"' in (tmp_path / "out" / "arm.xml").read_text()  # degrees
    assert written.share < 1e-6
    assert (tmp_path / "out" / "scene.xml").read_text().count("limo wrote") == 1  # and no more
    assert "meshdir" not in written.file.read_text().replace('<compiler meshdir="meshes"/>', "")


def test_another_arm_is_refused(model, tmp_path):
    other = tmp_path / "other.xml"
    other.write_text(arm_of(4))
    simulation = Simulation.load(model)
    with pytest.raises(ConfigError, match="joint hinge0 stands elsewhere"):
        limo.export(simulation, "mjcf", tmp_path / "out", into=other)
    other.write_text(arm_of(3).replace("hinge1", "knee"))
    with pytest.raises(ConfigError, match="has no joint 'hinge1'"):
        limo.export(simulation, "mjcf", tmp_path / "out", into=other)


def test_the_joint_that_stands_elsewhere_is_named(two_links_urdf, tmp_path):
    other = tmp_path / "other.urdf"
    other.write_text(two_links_urdf.read_text().replace('xyz="0.4 0 0"', 'xyz="0.5 0 0"'))
    with pytest.raises(ConfigError, match="joint b stands elsewhere"):
        limo.export(Simulation(str(two_links_urdf)), "urdf", tmp_path / "out", into=other)


REFUSED = [
    ({"to": "sdf"}, "no export to 'sdf', expected one of mjcf, urdf"),
    ({"to": "urdf", "into": "model.xml"}, "is MJCF, expected URDF"),
    ({"to": "mjcf", "out": "."}, "would be written over|is written over|also an input|is an input"),
]


@pytest.mark.parametrize(("how", "said"), REFUSED)
def test_what_cannot_be_written_is_refused(model, tmp_path, monkeypatch, how, said):
    monkeypatch.chdir(tmp_path)
    given = {"out": "out", **how}
    with pytest.raises(ConfigError, match=said):
        limo.export(Simulation.load(model), **given)
    assert model.read_text() == arm_of(3)


def test_the_command_shows_diff_remainder_and_proof(model, tmp_path, monkeypatch, capsys):
    simulation = Simulation.load(model)
    more = (ViscousFriction(joint=1, f_v=0.5), TorqueOffset(joint=1, offset=1.0))
    replace(simulation, effects=(*simulation.effects, *more)).save(tmp_path / "sim.yaml")
    arguments = ["export", tmp_path / "sim.yaml", "--to", "mjcf", "--out", tmp_path / "out"]

    def run(*options):
        monkeypatch.setattr(sys, "argv", ["limo", *map(str, arguments), *options])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code or 0, capsys.readouterr().out

    status, said = run()
    assert status == 0
    assert 'damping="2"' in said  # 1.5 of its class and 0.5
    assert "left: torque_offset, joint 1 is not expressible: 1 N m" in said
    assert "MuJoCo alone needs what limo predicts, less what is left, to 0." in said
    status, said = run("--json")
    values = json.loads(said)
    assert values["share"] < 0.01
    assert values["not_expressed"]["torque_offset, joint 1"][0] == pytest.approx(1.0)
