"""Edits of XML: what is not edited stays to the byte."""

from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from limo_driver.errors import ConfigError
from limo_driver.exports.xml_edits import XmlText

TEXT = """<?xml version='1.0'?>
<!-- first > second -->
<arm a = '1'   b="x &gt; y"
     c="3">
  <joint name="one"
         damping='0.1'/> <!-- kept -->
  <joint name="two"></joint>
\t<body name="ü"/>
</arm>
"""


def parsed(data):
    return ET.fromstring(data)  # noqa: S314  # our own


@pytest.fixture
def text(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(TEXT, encoding="utf-8")
    return XmlText(path)


def test_without_edits_it_is_the_same(text):
    assert text.text() == TEXT


def test_values_change_in_their_place(text):
    text.set(text.find("joint", "one"), "damping", "0.2")
    text.set(text.root, "b", 'a "b" <')
    changed = TEXT.replace("'0.1'", '"0.2"').replace('"x &gt; y"', '"a &quot;b&quot; &lt;"')
    assert text.text() == changed
    assert parsed(changed.encode()).get("b") == 'a "b" <'


def test_a_value_that_is_the_same_is_no_edit(text):
    text.set(text.find("joint", "one"), "damping", "0.1")
    assert text.text() == TEXT


def test_attributes_are_added_and_removed(text):
    joint = text.find("joint", "one")
    text.remove(joint, "damping", "nothing")
    text.set(joint, "armature", "1")
    text.set(joint, "stiffness", "2")
    text.set(text.find("joint", "two"), "damping", "3")
    found = parsed(text.text().encode())
    assert found[0].attrib == {"name": "one", "armature": "1", "stiffness": "2"}
    assert found[1].attrib == {"name": "two", "damping": "3"}
    assert "<!-- kept -->" in text.text()


def test_lines_are_inserted_first_also_into_what_is_empty(text):
    text.insert(text.find("body", "ü"), "<inertial/>")
    text.insert(text.root, "<option/>")
    found = parsed(text.text().encode())
    assert found[0].tag == "option"
    assert found[3][0].tag == "inertial"
    assert '\t<body name="ü">\n\t  <inertial/>\n\t</body>\n' in text.text()


def test_elements_go_with_the_line_that_they_begin(text):
    text.drop(text.find("joint", "two"))
    text.drop(text.find("body", "ü"))
    assert text.text() == TEXT.replace('  <joint name="two"></joint>\n', "").replace(
        '\t<body name="ü"/>\n', ""
    )


def test_an_element_behind_others_goes_alone(tmp_path):
    (path := tmp_path / "arm.xml").write_text("<a>\n  <b/> <c><d/></c> <e/></a>")
    text = XmlText(path)
    text.drop(text.root.child("c"))
    assert text.text() == "<a>\n  <b/>  <e/></a>"


def test_lines_come_behind_an_element_and_at_the_end(text):
    text.insert_after(text.find("joint", "two"), "<joint/>")
    text.append(text.root, "<end/>")
    wanted = TEXT.replace("</joint>\n", "</joint>\n  <joint/>\n").replace(
        "</arm>", "  <end/>\n</arm>"
    )
    assert text.text() == wanted


NAMES = st.sampled_from(["a", "b", "c"])
VALUES = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=8)


@given(st.dictionaries(NAMES, VALUES), NAMES, VALUES)
def test_any_value_is_read_back(tmp_path_factory, attributes, name, value):
    element = ET.Element("arm", attributes)
    path = tmp_path_factory.mktemp("xml") / "arm.xml"
    path.write_bytes(ET.tostring(element, encoding="utf-8"))
    text = XmlText(path)
    text.set(text.root, name, value)
    assert parsed(text.text().encode()).attrib == attributes | {name: value}


def test_what_is_no_xml_is_refused(tmp_path):
    (tmp_path / "arm.xml").write_text("<arm>")
    with pytest.raises(ConfigError, match="is no XML"):
        XmlText(tmp_path / "arm.xml")
