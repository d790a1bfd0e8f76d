"""A load that an export added: a later export changes it or takes it away, and adds no second."""

from dataclasses import replace

import numpy as np
import pytest
from lanes import later

import limo_driver as limo
from limo_driver.exports.changes.bodies import (
    AddedBody,
    BodyPart,
    parts_of,
    replaced_bodies,
    still_there,
)
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import Payload, Simulation

ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body name="l1"><joint name="yaw" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".05" mass="3"/>
<body name="l2" pos="0 0 .2"><joint name="elbow" axis="0 1 0" pos="0 0 .01"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/>
<body name="tool" pos="0 0 .3"><geom type="box" size=".02 .02 .02" mass="0.2"/></body>
</body></body>
</worldbody></mujoco>
"""
HEAVY = Payload(mass=0.9, com=(0.01, 0.02, 0.35), inertia=(0.002, 0, 0, 0.002, 0, 0.001))
LIGHT = Payload(mass=0.2, com=(0.0, 0.0, 0.3))
KINDS = ["urdf", "mjcf", "drake", "isaaclab"]


@pytest.fixture(params=later(KINDS, "writes files, and has a simulator read each"))
def arm(request, tmp_path, two_links_urdf):
    """A kind of export, and an arm for it."""
    if request.param != "mjcf":
        return request.param, two_links_urdf
    path = tmp_path / "arm.xml"
    path.write_text(ARM, encoding="utf-8")
    return request.param, path


def masses(file):
    """The mass of each body of a file, by name."""
    parts = parts_of(limo.RobotModel(file))
    return {p.name: p.inertial.mass for of in parts.values() for p in of if p.inertial is not None}


def carrying(file, *loads):
    """A simulation of a file whose last link is heavier than stated, with loads."""
    arm = limo.RobotModel(file)
    link, body = list(arm.inertials.items())[-1]
    return Simulation(str(file), loads, inertials={link: replace(body, mass=1.1 * body.mass)})


def test_the_same_again_changes_nothing(arm, tmp_path):
    kind, file = arm
    first = limo.export(carrying(file, HEAVY), kind, tmp_path / "1").file
    into = first
    for again in "23":
        written = limo.export(carrying(file, HEAVY), kind, tmp_path / again, into=into)
        assert (written.diff, written.dropped) == ("", ())
        assert written.file.read_bytes() == first.read_bytes()
        into = written.file
    assert masses(into)["payload"] == pytest.approx(0.9)


def test_another_load_takes_its_place(arm, tmp_path):
    kind, file = arm
    first = limo.export(carrying(file, HEAVY), kind, tmp_path / "1").file
    second = limo.export(carrying(file, LIGHT), kind, tmp_path / "2", into=first)
    afresh = limo.export(carrying(file, LIGHT), kind, tmp_path / "3").file
    assert masses(second.file) == pytest.approx(masses(afresh))
    assert "payload_1" not in second.file.read_text()
    assert second.share < 1e-3
    third = limo.export(carrying(file, HEAVY), kind, tmp_path / "4", into=second.file)
    assert third.file.read_bytes() == first.read_bytes()


def test_a_load_in_mjcf_keeps_its_body(tmp_path):
    (file := tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    first = limo.export(Simulation(str(file), (HEAVY,)), "mjcf", tmp_path / "1").file
    second = limo.export(Simulation(str(file), (LIGHT,)), "mjcf", tmp_path / "2", into=first)
    assert masses(second.file)["payload"] == pytest.approx(0.2)
    assert second.share < 1e-3


def test_a_load_that_is_found_no_longer_goes(arm, tmp_path):
    kind, file = arm
    first = limo.export(carrying(file, HEAVY), kind, tmp_path / "1").file
    second = limo.export(carrying(file), kind, tmp_path / "2", into=first)
    assert (
        second.file.read_bytes()
        == limo.export(carrying(file), kind, tmp_path / "3").file.read_bytes()
    )
    (said,) = second.dropped
    assert said.startswith("body payload of 0.9 kg on ")
    assert "payload" in second.diff
    assert second.share < 1e-3


def test_who_goes_on_with_the_exported_file_has_the_load_in_it(arm, tmp_path):
    kind, file = arm
    first = limo.export(Simulation(str(file), (HEAVY,)), kind, tmp_path / "1").file
    more = limo.export(Simulation(str(first), (LIGHT,)), kind, tmp_path / "2")
    had = masses(first)
    assert masses(more.file) == pytest.approx({**had, "payload_1": 0.2})
    less = limo.export(Simulation(str(first)), kind, tmp_path / "3", into=more.file)
    assert less.file.read_bytes() == first.read_bytes()
    back = limo.export(Simulation(str(file)), kind, tmp_path / "4", into=more.file)
    assert masses(back.file) == pytest.approx(masses(file))
    assert [line.split(",")[0].split(" on ")[0] for line in sorted(back.dropped)] == [
        "body payload of 0.9 kg",
        "body payload_1 of 0.2 kg",
    ]


def test_a_load_that_somebody_changed_is_the_users(arm, tmp_path):
    kind, file = arm
    first = limo.export(Simulation(str(file), (HEAVY,)), kind, tmp_path / "1").file
    first.write_text(first.read_text().replace('="0.9"', '="0.8"'), encoding="utf-8")
    found = limo.export(Simulation(str(first), (LIGHT,)), kind, tmp_path / "2")
    assert masses(found.file)["payload"] == 0.8
    assert masses(found.file)["payload_1"] == pytest.approx(0.2)
    assert found.file.read_text().count('"payload": {"on"') == 0


def test_two_loads_have_names_of_their_own(arm, tmp_path):
    kind, file = arm
    written = limo.export(Simulation(str(file), (HEAVY, LIGHT)), kind, tmp_path / "1")
    found = masses(written.file)
    assert (found["payload"], found["payload_1"]) == pytest.approx((0.9, 0.2))
    one = limo.export(Simulation(str(file), (LIGHT,)), kind, tmp_path / "2", into=written.file)
    assert masses(one.file) == pytest.approx({**masses(file), "payload": 0.2})


def test_a_comment_that_makes_no_sense_names_no_body(arm, tmp_path):
    kind, file = arm
    first = limo.export(Simulation(str(file), (HEAVY,)), kind, tmp_path / "1").file
    head, tail = first.read_text().split("<!-- limo added: ")
    tail = tail[tail.index(" -->") :]
    said = ["{}", '{"payload": 3}', '{"payload": {"on": "l2", "mass": "x"}}', "{]}", "[1]"]
    for each in said if kind == "urdf" else said[:1]:  # one reader of all formats
        first.write_text(f"{head}<!-- limo added: {each}{tail}", encoding="utf-8")
        again = limo.export(Simulation(str(first)), kind, tmp_path / "2")
        assert masses(again.file) == pytest.approx(masses(first))


def test_only_what_brings_the_link_nearer_is_taken_away():
    def ball(mass, x):
        moment = 0.01 * mass
        return Inertial(mass, (x, 0.0, 0.0), (moment, 0.0, 0.0, moment, 0.0, moment))

    bodies = {"a": ball(0.5, 0.1), "b": ball(0.3, 0.2), "own": ball(0.7, 0.0)}
    parts = [
        BodyPart("link", ball(2.0, 0.0), np.eye(4)),
        *(BodyPart(name, body, np.eye(4)) for name, body in bodies.items()),
    ]
    added = {name: AddedBody("link", bodies[name]) for name in "ab"}
    with_own = parts[0].inertial.joined(bodies["own"])
    assert replaced_bodies(parts, added, with_own) == ("a", "b")
    assert replaced_bodies(parts, added, with_own.joined(bodies["b"])) == ("a",)
    assert replaced_bodies(parts, added, with_own.joined(bodies["a"]).joined(bodies["b"])) == ()
    elsewhere = {name: replace(each, on="other") for name, each in added.items()}
    assert still_there(added | {"gone": added["a"]}, [parts]) == added
    assert still_there(elsewhere, [parts]) == {}
