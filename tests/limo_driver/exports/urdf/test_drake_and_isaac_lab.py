"""Exports for Drake and Isaac Lab: a URDF, and where each has the rest."""

import ast
import re
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.exports.changes.origin import FileOrigin
from limo_driver.exports.urdf import actuators, rotors_of, write_rotors
from limo_driver.exports.xml_edits import XmlText
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    PositionServo,
    Simulation,
    ViscousFriction,
)

TRANSMISSION = """<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
  <joint name="lower"/><actuator name="a"><drake:gear_ratio value="10"/></actuator></transmission>
"""


@pytest.fixture
def arm(two_links_urdf, tmp_path):
    """An arm with friction, damping and armature; where its second joint has a transmission."""
    path = tmp_path / "own" / "arm.urdf"
    path.parent.mkdir()
    text = two_links_urdf.read_text()
    second = limo.RobotModel.load(two_links_urdf).joint_names[1]
    head, tail = text.rsplit("</robot>", 1)
    path.write_text(f"{head}{TRANSMISSION.replace('lower', second)}</robot>{tail}")
    path.write_text(
        path.read_text().replace("<robot ", '<robot xmlns:drake="http://drake.mit.edu" ')
    )
    effects = (
        CoulombFriction(joint=1, tau_c=0.7, v_eps=0.003),
        ViscousFriction(joint=1, f_v=0.9),
        ViscousFriction(joint=2, f_v=0.4),
        Armature(joint=1, inertia=0.05),
        Armature(joint=2, inertia=0.2),
    )
    load = Payload(mass=0.8, com=(0.01, 0.02, 0.05), inertia=(0.002, 0, 0, 0.002, 0, 0.001))
    return Simulation(str(path), (load, *effects))


def test_drake_has_inertias_of_rotors_and_no_dry_friction(arm, tmp_path):
    found = limo.export(arm, "drake", tmp_path / "out")
    assert found.share < 1e-6
    first, second = arm.model.joint_names
    assert rotors_of(XmlText(found.file)) == pytest.approx({first: 0.05, second: 0.2})
    text = found.file.read_text()
    assert '<drake:rotor_inertia value="0.002"/>' in text  # behind the gear of 10 that is there
    assert text.count("<transmission") == 2
    assert "friction=" not in text
    (left,) = found.remainder
    assert left.place == "coulomb_friction, joint 1"
    assert left.rms[0] == pytest.approx(0.7, rel=0.05)


def test_rotors_that_an_earlier_export_wrote_go_with_their_effect(arm, tmp_path):
    first = limo.export(arm, "drake", tmp_path / "1").file
    again = limo.export(arm, "drake", tmp_path / "2", into=first)
    assert again.diff == ""
    goes_on = limo.export(Simulation(str(first)), "drake", tmp_path / "own").file
    assert rotors_of(XmlText(goes_on)) == rotors_of(XmlText(first))
    bare = Simulation(str(arm.model.urdf), (Armature(joint=2, inertia=0.3),))
    second = limo.export(bare, "drake", tmp_path / "3", into=first)
    _, lower = arm.model.joint_names
    assert rotors_of(XmlText(second.file)) == pytest.approx({lower: 0.3})
    none = limo.export(Simulation(str(arm.model.urdf)), "drake", tmp_path / "4", into=second.file)
    assert rotors_of(XmlText(none.file)) == {}
    assert none.file.read_text().count("<transmission") == 1  # the user's, with its gear


def test_a_rotor_of_the_users_own_stays(arm, tmp_path):
    first = limo.export(arm, "drake", tmp_path / "1").file
    own = tmp_path / "own.urdf"
    own.write_text("".join(x for x in first.read_text().splitlines(True) if "limo " not in x))
    _, second = arm.model.joint_names
    found = limo.export(Simulation(str(own)), "drake", tmp_path / "2")
    assert rotors_of(XmlText(found.file))[second] == pytest.approx(0.2)
    assert found.diff == ""


def test_rotors_are_those_of_actuators_in_transmissions_of_joints(tmp_path):
    (path := tmp_path / "arm.urdf").write_text("""<robot xmlns:drake="http://drake.mit.edu">
<transmission><joint name="a"/></transmission>
<transmission><actuator name="b"><drake:rotor_inertia value="1"/></actuator></transmission>
<part><joint name="c"/><actuator><drake:rotor_inertia value="1"/></actuator></part>
<transmission><joint name="d"/><actuator name="d"/></transmission>
<transmission><joint name="e"/><actuator name="e"><drake:rotor_inertia value="0.1"/></actuator>
</transmission>
</robot>""")
    text = XmlText(path)
    assert rotors_of(text) == {"e": 0.1}
    armature = {"a": 0.2, "b": 0.0, "c": 0.3, "d": 0.4, "e": 0.5}
    users, wanted = write_rotors(text, armature, FileOrigin(), keep=False)
    assert users == {"a": 0.0, "b": 0.0, "c": 0.0, "d": 0.0, "e": 0.1}
    assert wanted == armature
    path.write_text(text.text())
    assert rotors_of(XmlText(path)) == {"a": 0.2, "c": 0.3, "d": 0.4, "e": 0.5}
    assert path.read_text().count("<transmission") == 6  # two where none had an actuator


def test_isaac_lab_has_actuators_beside_the_urdf(arm, tmp_path, monkeypatch):
    found = limo.export(arm, "isaaclab", tmp_path / "out")
    assert found.share < 1e-6
    assert not found.remainder
    module = ModuleType("isaaclab.actuators")
    module.ImplicitActuatorCfg = SimpleNamespace
    monkeypatch.setitem(sys.modules, "isaaclab", ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", module)
    written = tmp_path / "out" / "arm.py"
    assert written in found.files
    names = arm.model.joint_names
    said = {}
    exec(written.read_text(), said)  # noqa: S102  # as Isaac Lab would
    assert said["ARM"].joint_names_expr == list(names)
    np.testing.assert_allclose(list(said["ARM"].armature.values()), [0.05, 0.2])
    np.testing.assert_allclose([said["ARM"].friction[name] for name in names], [0.7, 0.0])
    assert said["ARM"].dynamic_friction == said["ARM"].friction
    np.testing.assert_allclose([said["ARM"].viscous_friction[name] for name in names], [0.9, 0.4])


def test_isaac_lab_has_the_gains_of_servos(monkeypatch):
    module = ModuleType("isaaclab.actuators")
    module.ImplicitActuatorCfg = SimpleNamespace
    monkeypatch.setitem(sys.modules, "isaaclab", ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", module)
    servo = PositionServo(joint=2, kp=17.8, kd=0.6, torque_limit=3.35, delay=0.02, play=0.01)
    said = {}

    text = actuators("arm.urdf", ("lift", "bend"), [JointDynamics(), JointDynamics()], [servo])
    exec(text, said)  # noqa: S102  # as Isaac Lab would

    assert said["ARM"].stiffness == {"bend": 17.8}
    assert said["ARM"].damping == {"bend": 0.6}
    assert said["ARM"].effort_limit_sim == {"bend": 3.35}
    assert "# not written: play [rad] of 'bend': 0.01" in text
    assert "not written: delay" in text


@pytest.mark.parametrize("target", ["drake", "isaaclab", "urdf"])
def test_names_of_any_characters_stay_what_they_are(arm, tmp_path, target):
    urdf = tmp_path / "own" / "arm.urdf"
    text = urdf.read_text()
    for name in (arm.model.joint_names[0], arm.model.link_names[-1]):
        text = text.replace(f'"{name}"', f'"{name} &amp; &lt;&quot;&gt;"')
    urdf.write_text(text)
    odd = Simulation(str(urdf), arm.effects)
    assert odd.model.joint_names[0].endswith(' & <">')

    found = limo.export(odd, target, tmp_path / "out")

    assert found.share < 0.01
    assert limo.RobotModel.load(tmp_path / "out" / "arm.urdf").joint_names == odd.model.joint_names
    if target == "isaaclab":
        assert re.escape(odd.model.joint_names[0]) in constants(tmp_path / "out" / "arm.py")


def constants(path):
    """Return the constants of a Python file."""
    tree = ast.parse(path.read_text())
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
