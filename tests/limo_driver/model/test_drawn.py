"""What is drawn of an arm: its own shapes and colours, and others where these are not there."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.model import RobotModel
from limo_driver.model.drawn import (
    TRIANGLES,
    LinkMesh,
    _revolved,
    clustered,
    drawing_of,
)
from limo_driver.pages import arm_view
from limo_driver.pages.motion import arm_section

URDF = """<robot name="two">
<material name="orange"><color rgba="1 0.5 0 1"/></material>
<link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry><material name="orange"/>
  </visual></link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
  iyz="0"/></inertial>
  <visual><origin xyz="0 0 0.5" rpy="0 1.5707963267948966 0"/><geometry>{shape}</geometry></visual>
  <collision><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision>
  <collision_checking/></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  <origin xyz="0 0 0.3"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
MJCF = """<mujoco><default>
<default class="hidden"><geom group="3" rgba="1 0 0 1"/></default></default>
<asset><material name="green" rgba="0 1 0 1"/></asset><worldbody><geom type="plane" size="1 1 1"/>
<body name="arm" pos="0 0 0.3"><joint name="turn" axis="0 0 1" pos="0 0 0.1" range="-1 1"/>
<geom type="capsule" fromto="0 0 0 0 0 1" size="0.05" material="green"/>
<geom type="ellipsoid" size="0.1 0.2 0.3" rgba="0 0 1 0.5" mass="0"/>
<geom class="hidden" type="box" size="9 9 9" mass="0"/></body></worldbody></mujoco>"""
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset>
<library_effects>{effects}</library_effects><library_materials>{materials}</library_materials>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="12">
0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor>
</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1" material="one"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p>
</triangles><polylist count="1" material="two"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>4</vcount><p>0 1 3 2</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="one" target="#red"/>
<instance_material symbol="two" target="#blue"/></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def model_of(folder, text, name="arm.urdf"):
    (folder / name).write_text(text)
    return RobotModel(folder / name)


def box_of(mesh):
    return np.round([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], 6).tolist()


def test_shapes_of_a_urdf_stand_where_they_are_drawn_in_their_colours(tmp_path):
    shape = '<cylinder radius="0.1" length="1"/>'
    base, arm = drawing_of(model_of(tmp_path, URDF.format(shape=shape))).meshes
    assert (base.joint, base.colour) == (-1, (1.0, 0.5, 0.0, 1.0))
    assert box_of(base) == [[-0.1, -0.1, -0.05], [0.1, 0.1, 0.05]]
    assert (arm.joint, arm.colour) == (0, None)
    assert box_of(arm) == [[-0.5, -0.1, 0.4], [0.5, 0.1, 0.6]]


def test_a_mesh_is_drawn_scaled(tmp_path):
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")
    body = np.zeros(3, "<f4").tobytes() + triangle.tobytes() + b"\0\0"
    (tmp_path / "a.STL").write_bytes(b"solid".ljust(80) + (1).to_bytes(4, "little") + body)
    shape = '<mesh filename="package://a.STL" scale="2 1 1"/>'
    _, arm = drawing_of(model_of(tmp_path, URDF.format(shape=shape))).meshes
    assert box_of(arm) == [[0.0, 0.0, -1.5], [0.0, 1.0, 0.5]]


def test_parts_of_an_obj_have_the_colours_of_its_library(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\n"
    obj = f"mtllib a.mtl\n{corners}usemtl red\nf 1/1 2/2 3/3 4/4\nusemtl none\nf -1 -2 -5\n"
    (tmp_path / "a.obj").write_text(obj)
    shape = '<mesh filename="a.obj"/>'
    _, *arm = drawing_of(model_of(tmp_path, URDF.format(shape=shape))).meshes
    assert [(mesh.colour, len(mesh.faces)) for mesh in arm] == [
        ((1.0, 0.0, 0.0, 1.0), 2),
        (None, 1),
    ]


def test_parts_of_a_collada_file_have_their_own_colours(tmp_path):
    colours = {"red": "1 0 0 1", "blue": "0 0 1 1"}
    effects = "".join(
        f'<effect id="{name}-fx"><profile_COMMON><technique sid="t"><lambert><diffuse><color>{rgba}'
        "</color></diffuse></lambert></technique></profile_COMMON></effect>"
        for name, rgba in colours.items()
    )
    materials = "".join(
        f'<material id="{name}"><instance_effect url="#{name}-fx"/></material>' for name in colours
    )
    (tmp_path / "a.dae").write_text(DAE.format(effects=effects, materials=materials))
    shape = '<mesh filename="a.dae"/>'
    _, *arm = drawing_of(model_of(tmp_path, URDF.format(shape=shape))).meshes
    assert [(mesh.colour, len(mesh.faces)) for mesh in arm] == [
        ((1.0, 0.0, 0.0, 1.0), 1),
        ((0.0, 0.0, 1.0, 1.0), 2),
    ]


@pytest.mark.parametrize("content", [None, b"no mesh"])
def test_for_a_mesh_that_is_lost_a_collision_shape_stands_and_the_page_says_so(tmp_path, content):
    if content:
        (tmp_path / "gone.stl").write_bytes(content)
    shape = '<mesh filename="gone.stl"/>'
    model = model_of(tmp_path, URDF.format(shape=shape))
    drawing = drawing_of(model)
    assert drawing.lost == ("gone.stl",)
    assert {mesh.joint for mesh in drawing.meshes} == {-1, 0}  # the cylinder of its collisions
    page = arm_section(arm_view(model, np.zeros(1)), "The arm", "")
    assert page.count("gone.stl") == 1


def test_geoms_of_an_mjcf_are_those_that_its_viewer_shows(tmp_path):
    found = drawing_of(model_of(tmp_path, MJCF, "arm.xml")).meshes
    assert [mesh.colour for mesh in found] == [(0.0, 1.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.5)]
    assert box_of(found[0]) == [[-0.05, -0.05, -0.15], [0.05, 0.05, 0.95]]  # from the anchor
    assert box_of(found[1]) == [[-0.1, -0.2, -0.4], [0.1, 0.2, 0.2]]


def test_thinned_it_keeps_its_size_and_no_triangle_twice():
    sphere = _revolved(np.array([[np.cos(a), np.sin(a)] for a in np.linspace(-1.57, 1.57, 400)]))
    mesh = LinkMesh(0, *sphere)
    twice = LinkMesh(0, mesh.vertices, np.concatenate([mesh.faces, np.roll(mesh.faces, 1, axis=1)]))
    thin, other = clustered(mesh, 0.05), clustered(twice, 0.05)
    assert len(thin.faces) == len(other.faces) < len(mesh.faces) / 4
    assert np.abs(np.array(box_of(thin)) - box_of(mesh)).max() < 0.05
    assert len(mesh.faces) < TRIANGLES
