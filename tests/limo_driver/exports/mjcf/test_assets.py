"""Meshes beside the folder of an MJCF file come along; what lies farther away does not."""

import os

import mujoco
import numpy as np
import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.physics import Payload, Simulation

LOAD = Payload(mass=0.4, com=(0.0, 0.0, 0.1))
ARM = (
    '<mujoco><compiler {compiler}/><asset><mesh name="link" file="{file}"/></asset><worldbody>'
    '<body name="link"><joint name="hinge" axis="0 1 0" range="-90 90"/>'
    '<geom type="mesh" mesh="link" density="2000"/></body></worldbody></mujoco>'
)


def stl():
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype="<f4")
    data = bytes(80) + np.uint32(4).tobytes()
    for face in [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]:
        data += np.zeros(3, "<f4").tobytes() + corners[list(face)].tobytes() + bytes(2)
    return data


@pytest.fixture
def arm(tmp_path):
    """A file in lab/robots/arm, with a mesh where it is said to be."""

    def make(compiler, file, mesh):
        folder = tmp_path / "lab" / "robots" / "arm"
        folder.mkdir(parents=True, exist_ok=True)
        place = folder / mesh
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(stl())
        path = folder / "arm.xml"
        path.write_text(ARM.format(compiler=compiler, file=file), encoding="utf-8")
        return path

    return make


@pytest.mark.parametrize("up", ["..", "../.."])
@sampled("attribute", ["meshdir", "assetdir"], "writes and compiles a file each")
def test_a_folder_beside_that_of_the_file_stands_in_that_of_the_copy(arm, tmp_path, up, attribute):
    path = arm(f'{attribute}="{up}/assets/"', "sub/link.stl", f"{up}/assets/sub/link.stl")
    before = path.read_bytes()
    written = limo.export(Simulation(str(path), (LOAD,)), "mjcf", tmp_path / "out")
    assert path.read_bytes() == before
    assert (tmp_path / "out" / "assets" / "sub" / "link.stl").read_bytes() == stl()
    assert f'<compiler {attribute}="assets"/>' in written.file.read_text()
    moved = tmp_path / "elsewhere"
    os.rename(tmp_path / "out", moved)  # nothing of it points back
    assert mujoco.MjModel.from_xml_path(str(moved / "arm.xml")).nmesh == 1
    again = limo.export(Simulation(str(moved / "arm.xml")), "mjcf", tmp_path / "again")
    assert again.diff == ""


def test_a_folder_of_the_same_name_is_not_mixed_with_it(arm, tmp_path):
    path = arm('meshdir="../assets"', "link.stl", "../assets/link.stl")
    (path.parent / "assets").mkdir()
    written = limo.export(Simulation(str(path)), "mjcf", tmp_path / "out")
    assert 'meshdir="assets_beside"' in written.file.read_text()
    assert (tmp_path / "out" / "assets_beside" / "link.stl").is_file()


def test_an_absolute_path_stays_as_it_is(arm, tmp_path):
    folder = tmp_path / "lab" / "meshes"
    path = arm(f'meshdir="{folder}"', "link.stl", "../../meshes/link.stl")
    written = limo.export(Simulation(str(path), (LOAD,)), "mjcf", tmp_path / "out")
    assert f'meshdir="{folder}"' in written.file.read_text()
    assert [file.name for file in written.files] == ["arm.xml"]


@pytest.mark.parametrize(
    ("compiler", "file", "mesh"),
    [
        ("", "../link.stl", "../link.stl"),
        ('meshdir="../assets"', "../other/link.stl", "../other/link.stl"),
        ('meshdir="../../../assets"', "link.stl", "../../../assets/link.stl"),
    ],
)
def test_what_lies_elsewhere_is_not_copied(arm, tmp_path, compiler, file, mesh):
    path = arm(compiler, file, mesh)
    with pytest.raises(ConfigError, match="expected it in the folder of the file, or in a meshdir"):
        limo.export(Simulation(str(path)), "mjcf", tmp_path / "out")
    assert not (tmp_path / "out" / "arm.xml").exists()


def test_a_mesh_that_never_ends_is_refused(arm):
    path = arm("", "link.stl", "link.stl")
    (path.parent / "link.stl").unlink()
    os.mkfifo(path.parent / "link.stl")
    with pytest.raises(ConfigError, match=r"names link\.stl as a mesh, which is no file"):
        limo.RobotModel.load(path)
