"""Names of somebody else are data in whatever limo writes: each language reads them as such."""

import ast
import re
import shutil
import string
import subprocess
import unicodedata
import xml.etree.ElementTree as ET  # of files that limo wrote
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lanes import later, sampled

import limo_driver as limo
from estimators.embedded.export import export_c
from estimators.embedded.ros2_package import export_ros2
from limo_driver import quoting
from limo_driver.errors import ConfigError
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    PositionServo,
    PreslidingHysteresis,
    Simulation,
)

HOSTILE = (
    "*/ int main(void){return 7;} /*", "??/\n int broken", '""" + __import__("os") + """', "\\",
    '"); import os; ("', "'; rm -rf x; '", "$(touch owned)", "`touch owned`", "-rf", "a b\tc",
    "<script>owned()</script>", '" onload="owned()', "&lt;&amp;", "]]><x/><![CDATA[", "--><x/>",
    "[owned](javascript:x)", "|a|b|", "# title", "=cmd|'/c calc'!A1", "@SUM(1)", "\x1b[31mred\x07",
    "\u202egnp.exe", "{{ 7*7 }}", "%s%n", "!!python/object:os.system", "a: [b", "é\N{SNOWMAN}",
)  # fmt: skip
PIECES = st.sampled_from([*HOSTILE, *"*/\\\"'`$<>&;|?!#%{}[]()\n\r\t\x00\x1b \u2028\u202e"])
NAMES = st.one_of(
    st.sampled_from(HOSTILE), st.lists(PIECES, max_size=6).map("".join), st.text(max_size=20)
)
LISTS = st.lists(NAMES, min_size=1, max_size=30)
often = settings(deadline=None, max_examples=60)


def is_shown_only(text):
    """Say whether a terminal shows a text and obeys nothing in it."""
    return all(c == "\n" or c.isprintable() or c.isspace() for c in text) and "\x1b" not in text


@often
@given(NAMES)
def test_a_terminal_shows_them_in_one_line(name):
    shown = quoting.in_line(name)
    assert is_shown_only(shown)
    assert len(shown.splitlines()) <= 1


@often
@given(NAMES)
def test_a_docstring_of_python_ends_where_it_did(name):
    text = f'"""About:\n{quoting.in_docstring(name)}\n"""\nkept = 1\n'
    module = ast.parse(text)
    assert [type(item).__name__ for item in module.body] == ["Expr", "Assign"]
    assert ast.literal_eval(module.body[0].value) == f"About:\n{name}\n"


@often
@given(NAMES)
def test_an_attribute_of_xml_ends_where_it_did(name):
    element = ET.fromstring(  # noqa: S314
        f'<arm><joint name="{quoting.in_xml(name)}"/><end/></arm>'
    )
    assert [child.tag for child in element] == ["joint", "end"]
    assert set(element[0].attrib) == {"name"}
    assert element[0].get("name") == quoting.for_xml(name)


class Tags(HTMLParser):
    """Notes what a browser would make of a text."""

    def __init__(self):
        super().__init__()
        self.found, self.text = [], ""

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, tuple(name for name, _ in attrs)))

    def handle_data(self, data):
        self.text += data


@often
@given(NAMES)
def test_html_has_no_tag_or_attribute_more(name):
    said, page = quoting.in_html(name), Tags()
    page.feed(f'<p title="{said}">{said}</p>')
    page.close()
    assert page.found == [("p", ("title",))]
    assert page.text == quoting.on_terminal(name)


@often
@given(NAMES)
def test_markdown_makes_nothing_of_them(name):
    markdown = pytest.importorskip("markdown")
    page = Tags()
    page.feed(
        markdown.markdown(f"| a |\n|---|\n| {quoting.in_markdown(name)} |", extensions=["tables"])
    )
    assert {tag for tag, _ in page.found} <= {"table", "thead", "tbody", "tr", "th", "td"}
    assert sum(tag == "td" for tag, _ in page.found) == 1


@settings(deadline=None, max_examples=30, suppress_health_check=list(HealthCheck))
@given(names=st.lists(NAMES.filter(lambda name: "\0" not in name and name.isascii()), min_size=1))
def test_a_shell_hands_them_on_as_they_are(names, tmp_path_factory):
    line = quoting.in_shell("printf", "%s\\0", *names)
    folder = tmp_path_factory.mktemp("shell")
    done = subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, check=True)
    assert done.stdout.decode().split("\0")[:-1] == names
    assert not list(folder.iterdir())


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
@settings(deadline=None, max_examples=10, suppress_health_check=list(HealthCheck))
@given(names=LISTS)
def test_a_comment_of_c_ends_where_it_did(names, tmp_path_factory):
    file = tmp_path_factory.mktemp("c") / "names.c"
    comments = [f"/* {quoting.in_c_comment(name)} */" for name in names]
    cases = [f"{comment} case {k}: return {k};" for k, comment in enumerate(comments)]
    body = "\n".join(cases)
    file.write_text(f"int f(int k) {{ switch (k) {{\n{body}\ndefault: return -1; }} }}\n")
    strict = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", str(file)]
    subprocess.run(strict, check=True)
    bare = subprocess.run(["gcc", "-std=c11", "-E", "-P", file], capture_output=True, check=True)
    assert bare.stdout.count(b"return") == len(names) + 1


@often
@given(LISTS)
def test_a_literal_of_c_is_of_one_line_and_of_nothing_else(names):
    for name in names:
        literal = quoting.in_c_string(name)
        assert set(literal[1:-1]) <= {*" _-.\\", *map(chr, range(48, 58)), *string.ascii_letters}
        said = ast.literal_eval(f"b{literal}")
        assert said == name.encode("utf-8", "surrogateescape")


# Every writer, on an arm with such names ---------------------------------------------------------


IN_USD = ["\u540d\u524d", "__import__", "None", "a\u0301"]
CREEPING = PreslidingHysteresis(joint=2, law="lugre", sigma_0=300.0, tau_c=0.6)
IN_URDF = [name for name in HOSTILE if "$(" not in name]  # which says that it is a xacro


PAIRS = range(0, len(IN_URDF) - 1, 2)


@pytest.fixture(params=PAIRS, ids=lambda k: f"names {k} and {k + 1}")
def arm(request, two_links_urdf, tmp_path):
    """An arm of two joints with names of somebody else; and its folder has one, too."""
    first, second = map(quoting.for_xml, IN_URDF[request.param : request.param + 2])
    text = two_links_urdf.read_text()
    for old, new in zip(
        limo.RobotModel.load(two_links_urdf).joint_names, (first, second), strict=True
    ):
        text = text.replace(f'name="{old}"', f'name="{quoting.in_xml(new)}"')
    path = tmp_path / "own" / ("arm " + first.replace("/", "").replace("#", "")[:60] + ".urdf")
    path.parent.mkdir()
    path.write_text(text, "utf-8")
    found = limo.RobotModel.load(path)
    assert found.joint_names == (first, second)
    effects = (CoulombFriction(joint=1, tau_c=0.7, v_eps=0.003), Armature(joint=2, inertia=0.2))
    return Simulation(str(path), effects)


def test_sim_yaml_is_read_back(arm, tmp_path):
    arm.save(tmp_path / "sim.yaml")
    assert Simulation.load(tmp_path / "sim.yaml").model.joint_names == arm.model.joint_names
    yaml.safe_load((tmp_path / "sim.yaml").read_text("utf-8"))


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
@sampled("arm", PAIRS, "compiles C for each", first=3, indirect=True)
def test_exported_c_is_compiled_to_what_it_was(arm, tmp_path):
    written = export_c(arm, tmp_path, 250.0)
    strict = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-trigraphs", "-c", "-o", "x.o"]
    subprocess.run([*strict, str(written.source)], cwd=tmp_path, check=True)
    symbols = subprocess.run(
        ["nm", "x.o"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    defined = [line.split()[-1] for line in symbols.stdout.splitlines() if " T " in line]
    assert defined
    assert all(name.startswith("limo_") for name in defined)


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
@sampled("arm", PAIRS, "compiles C++ for each", first=2, indirect=True)
def test_a_ros_package_has_them_as_texts(arm, tmp_path):
    export_ros2(arm, tmp_path, 250.0)
    for file in tmp_path.glob("*.xml"):
        ET.fromstring(file.read_text("utf-8"))  # noqa: S314
    config = yaml.safe_load((tmp_path / "config" / "wrench_broadcaster.yaml").read_text("utf-8"))
    (parameters,) = config.values()
    names = list(arm.model.joint_names)
    assert parameters["ros__parameters"]["joints"] == names
    shown = tmp_path / "show.cpp"
    shown.write_text(
        '#include <cstdio>\n#include "src/arm.hpp"\n'
        "int main() { for (const auto &n : limo_dynamics::joint_names())\n"
        "std::fwrite(n.c_str(), 1, n.size() + 1, stdout); }\n"
    )
    strict = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-Wno-unused", "-trigraphs"]
    subprocess.run(["g++", *strict, shown.name, "-o", "show"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "show"], capture_output=True, check=True).stdout
    assert said.decode().split("\0")[:-1] == names


@pytest.mark.parametrize(
    ("arm", "target"),
    [
        case
        for i, target in enumerate(["drake", "isaaclab", "mjcf", "urdf"])
        for case in later(
            [pytest.param(2 * ((k + 3 * i) % len(PAIRS)), target) for k in range(len(PAIRS))],
            "writes the other names, too",
            first=2,
        )
    ],
    indirect=["arm"],
)
def test_exports_are_read_back(arm, target, tmp_path):
    servo = PositionServo(joint=1, kp=9.0, torque_limit=3.0)
    arm = replace(arm, effects=(*arm.effects, CREEPING), drives=(servo,))
    written = limo.export(arm, target, tmp_path / "out")
    files = [file for file in (tmp_path / "out").rglob("*") if file.is_file()]
    assert written.file in files
    for file in files:
        if file.suffix == ".py":
            kinds = {type(item).__name__ for item in ast.parse(file.read_text("utf-8")).body}
            assert kinds <= {"Expr", "ImportFrom", "Assign"}
        elif file.suffix in {".urdf", ".xml"}:
            names = {joint.get("name") for joint in ET.parse(file).iter("joint")}  # noqa: S314
            assert set(arm.model.joint_names) <= names
    assert limo.RobotModel.load(written.file).joint_names == arm.model.joint_names
    assert is_shown_only(str(written))
    again = limo.export(arm, target, tmp_path / "again", into=written.file)
    assert again.diff == ""


@sampled("names", zip(IN_URDF, IN_USD * 7, strict=False), "reads USD in processes", ids=ascii)
def test_a_layer_of_usd_is_read_back(names, tmp_path):
    pytest.importorskip("pxr", reason="needs usd-core: pip install limo[usd]")
    given, joint = names  # names of prims have letters, digits and _ only, of any language
    text = (Path(__file__).parents[1] / "regression" / "data" / "two_links.usda").read_text("utf-8")
    path = tmp_path / "own" / (re.sub("[/#]", "", quoting.for_xml(given))[:60] + ".usda")
    path.parent.mkdir()
    path.write_text(text.replace("turns_a", joint), "utf-8")
    drives = (PositionServo(joint=1, kp=9.0, dead_band=0.01, torque_limit=3.0),)
    sim = replace(Simulation(str(path), (CREEPING,)), drives=drives)
    if "\\" in path.name or any(unicodedata.category(letter) == "Cc" for letter in path.name):
        with pytest.raises(ConfigError, match="no layer of USD can refer") as refused:
            limo.export(sim, "usd", tmp_path / "out")
        assert is_shown_only(str(refused.value))
        return
    written = limo.export(sim, "usd", tmp_path / "out")
    assert all(file.parent == tmp_path / "out" and file.is_file() for file in written.files)
    assert len(written.files) == 3
    assert limo.RobotModel.load(written.file).joint_names == (joint, "turns_b")
    assert is_shown_only(str(written))


def test_a_line_for_the_shell_that_an_error_proposes_runs_nothing_else(two_links_urdf, tmp_path):
    path = tmp_path / "$(touch owned) 'arm.urdf"
    text = two_links_urdf.read_text()
    path.write_text(text.replace("<joint name=", '<joint note="$(find arm)" name=', 1))
    with pytest.raises(ConfigError, match="it is a xacro") as refused:
        limo.RobotModel.load(path)
    line = str(refused.value).rsplit("`", 2)[-2].replace("xacro", "printf '%s\\n'", 1)
    subprocess.run(["bash", "-c", line], cwd=tmp_path, check=True)
    assert not (tmp_path / "owned").exists()


def test_reports_show_them(arm):
    for shown in (str(arm), str(arm.model), repr(arm), repr(replace(arm, effects=()))):
        assert is_shown_only(shown)
