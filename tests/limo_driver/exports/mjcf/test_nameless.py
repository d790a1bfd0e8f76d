"""Bodies and joints without names, as files written by hand have them, take what was found."""

from dataclasses import replace

import mujoco
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.physics import CoulombFriction, Simulation

ARM = """<mujoco><worldbody>
  <geom type="plane" size="1 1 .1"/>
  <body><joint axis="0 0 1"/><geom type="capsule" fromto="0 0 0.1 0 0.1 0.4" size="0.05" mass="4"/>
    <body pos="0 0.1 0.4"><joint axis="0 1 0"/>
      <inertial mass="2" pos="0 0 0.1" diaginertia="0.02 0.02 0.01"/></body>
  </body>
</worldbody></mujoco>"""


def found_in(path):
    """An arm whose second link is heavier than the file says, and whose joints rub."""
    stated = Simulation.load(path)
    inertials = dict(stated.model.inertials)
    inertials["body_2"] = replace(inertials["body_2"], mass=2.5)
    effects = tuple(CoulombFriction(joint=j, tau_c=0.1 * j) for j in (1, 2))
    return replace(stated, inertials=inertials, effects=effects)


def test_what_has_no_name_is_found_by_its_place(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    exported = limo.export(found_in(tmp_path / "arm.xml"), "mjcf", tmp_path / "out")
    assert exported.share < 0.01
    model = mujoco.MjModel.from_xml_path(str(exported.file))
    assert model.body_mass.tolist() == pytest.approx([0, 4, 2.5])
    assert model.dof_frictionloss.tolist() == pytest.approx([0.1, 0.2])


def test_where_that_is_unsure_a_name_is_asked_for(tmp_path):
    start, end = ARM.index("<body>"), ARM.index("</worldbody>")
    (tmp_path / "part.xml").write_text(
        f"<mujocoinclude>{ARM[start:end]}</mujocoinclude>", encoding="utf-8"
    )
    text = f'{ARM[:start]}<include file="part.xml"/>{ARM[end:]}'
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"gives it no name: state one, <(body|joint) name="):
        limo.export(found_in(tmp_path / "arm.xml"), "mjcf", tmp_path / "out")


def test_what_is_made_by_attaching_is_to_be_written_out_first(tmp_path):
    named = ARM.replace("<joint axis", '<joint name="{}" axis')
    first, second, last = named.split("{}")
    (tmp_path / "part.xml").write_text(f"{first}yaw{second}tilt{last}", encoding="utf-8")
    cell = tmp_path / "cell.xml"
    cell.write_text(
        '<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody>'
        '<attach model="part" prefix="left_"/></worldbody></mujoco>',
        encoding="utf-8",
    )
    rubbing = Simulation(str(cell), (CoulombFriction(joint=1, tau_c=0.1),))
    with pytest.raises(ConfigError, match=r"left_yaw .* is made by <attach>.*to_xml\(\)"):
        limo.export(rubbing, "mjcf", tmp_path / "out")
    spec = mujoco.MjSpec.from_file(str(cell))
    spec.compile()
    whole = tmp_path / "whole.xml"
    whole.write_text(spec.to_xml(), encoding="utf-8")
    exported = limo.export(replace(rubbing, robot=str(whole)), "mjcf", tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(exported.file))
    assert model.joint("left_yaw").frictionloss == pytest.approx(0.1)
