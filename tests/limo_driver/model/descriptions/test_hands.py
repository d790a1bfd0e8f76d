"""MJCF files as they are published: hands whose linkages close, and two arms in a file."""

import mujoco
import numpy as np
import pytest
from linked_arms import pincer_arm

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel


@pytest.fixture
def file(tmp_path):
    def write(*prefixes):
        path = tmp_path / "arm.xml"
        path.write_text(pincer_arm(prefixes or ("",)), encoding="utf-8")
        return path

    return write


def torque_of_mujoco(path, joints, q, v, a):
    """Inverse dynamics of a file, the hand at rest where the file has it."""
    spec = mujoco.MjSpec.from_file(str(path))
    for equality in list(spec.equalities):
        spec.delete(equality)
    model = spec.compile()
    data = mujoco.MjData(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    places = [int(model.joint(name).qposadr[0]) for name in joints]
    armature = np.array([model.dof_armature[place] for place in places])
    data.qpos[places], data.qvel[places], data.qacc[places] = q, v, a
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[places] - armature * a


@pytest.mark.parametrize("prefixes", [("",), ("left/", "right/")])
def test_a_hand_whose_linkages_close_is_locked_and_weighs_what_it_does(file, prefixes):
    path, own = file(*prefixes), prefixes[-1]
    model = RobotModel.load(f"{path}#{own}yaw,{own}shoulder,{own}elbow" if own else path)
    names = tuple(f"{own}{name}" for name in ("yaw", "shoulder", "elbow"))
    assert model.joint_names == names
    q, v, a = np.random.default_rng(0).uniform(-1, 1, (3, 1, 3))
    mine = model.inverse_dynamics(q, v, a)
    expected = torque_of_mujoco(path, names, q[0], v[0], a[0])
    np.testing.assert_allclose(mine[0], expected, rtol=1e-6, atol=1e-8)
    if not own:
        said = next(note for note in model.notes if "loop" in note)
        assert said.startswith(
            "joints left_driver, left_tip, left_spring, right_tip, right_spring of"
        )
        assert "of a loop that bodies close" in said
        assert "are locked at 0; what they carry is lumped" in said


def test_joints_of_a_loop_that_are_chosen_move(file):
    model = RobotModel.load(f"{file()}#yaw,left_tip")
    assert model.joint_names == ("yaw", "left_tip")
    assert "not represented: 2 equality constraints" in model.notes


def test_of_two_arms_in_a_file_one_has_to_be_chosen(file):
    path = file("left/", "right/")
    with pytest.raises(
        ConfigError, match=r"arms of 9 hinges, left/turret, right/turret; choose .*as"
    ) as found:
        RobotModel.load(path)
    reference = str(found.value).rpartition(" as in ")[2]
    assert reference == "arm.xml#left/*"
    chosen = RobotModel.load(path.parent / reference)
    assert all(name.startswith("left/") for name in chosen.joint_names)
    assert "left aside: right/turret" in chosen.notes
