"""Descriptions whose links are no tree, or whose joints have no axis, are refused in one line."""

import pytest

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel


def urdf(*joints, axis="0 1 0"):
    """Links a, b and c, and joints from one to another."""
    links = "".join(f'<link name="{name}"/>' for name in "abc")
    said = "".join(
        f'<joint name="{start}{end}" type="revolute"><parent link="{start}"/><child link="{end}"/>'
        f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for start, end in joints
    )
    return f'<robot name="x">{links}{said}</robot>'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (urdf("ab", "bc", "ca"), "links a, b, c carry one another in a circle; expected a tree"),
        (urdf("ab", "ba"), "links a, b carry one another in a circle"),
        (urdf("aa"), "links a carry one another in a circle"),
        (urdf("ab", "cb"), "link b is moved by two joints, ab and cb; expected a tree"),
        (urdf("ab", axis="0 0 0"), "joint 'ab': its axis is 0 0 0, expected a direction"),
        (urdf("ab", axis="1 0"), "joint 'ab': xyz of its axis is 1 0, expected 3 numbers"),
    ],
)
def test_what_is_no_tree_is_refused(tmp_path, text, expected):
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=expected):
        RobotModel.load(tmp_path / "arm.urdf")
