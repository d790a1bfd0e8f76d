"""A page in a real browser: it draws, moves, fits a phone, and needs nothing but its file."""

from __future__ import annotations

import numpy as np
import pytest
from audit import reached_by_tab, violations
from browser import browser, program
from firefox import firefox
from firefox import program as firefox_program

from limo_driver.model import RobotModel
from limo_driver.pages import Charts, Ghost, Page, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.figures import Curve, Curves, LeftOutRows, curves_section
from limo_driver.pages.markup import paragraph, table
from limo_driver.pages.motion import arm_section

pytestmark = [
    pytest.mark.slow("starts a browser"),
    pytest.mark.skipif(program() is None, reason="no Chromium is installed on this machine"),
]
T, N = 200, 7
DRAWN = "document.body.dataset.arm === 'drawn' && document.body.dataset.charts === 'drawn'"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    time = np.linspace(0.0, 20.0, T)
    position = 0.5 * np.sin(time)[:, None] * np.ones(N)
    error = np.sin(np.outer(time, np.arange(1, N + 1)))
    motion = PlayedMotion(
        time, position,
        (
            Ghost("given", "#d9730d", error, position + 1e-3),
            Ghost("improved", "#0b559f", 0.1 * error),
        ),
        (PushArrow(5.0, 6.0, (0.0, 12.0, -5.0)),), "A motion.",
    )  # fmt: skip
    view = arm_view(
        RobotModel.load("iiwa14"), position[60], errors=(("given", (1.0,) * N),),
        floor=(0.1,) * N, pins=(Pin("flange: payload 0.8 kg", None, "#arm"),), motion=motion,
    )  # fmt: skip
    charts = Charts()
    line = {"data": [{"x": time.tolist(), "y": error[:, 0].tolist(), "mode": "lines"}],
            "layout": {"font": {}, "xaxis": {}, "yaxis": {}}, "height": 200}  # fmt: skip
    body = "<h1>A page</h1>" + arm_section(view, "The arm", "Drag to turn.")
    body += charts.place(line, "An error", follows=True) + paragraph("Text.")
    body += table(("joint", *"abcdefgh"), [["1", *["0.12345"] * 8]])
    path = tmp_path_factory.mktemp("page") / "page.html"
    Page("A page", body, charts, view).save(path)
    return path.as_uri()


@pytest.fixture(scope="module")
def tab():
    with browser() as opened:
        yield opened


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, False), (390, True)])
def test_it_draws_at_any_width_by_day_and_night(tab, address, width, dark):
    tab.look(address, width, 900, dark=dark)
    tab.wait(DRAWN)
    assert tab.errors == []
    assert tab.value("document.documentElement.scrollWidth") <= width
    paper = tab.value("getComputedStyle(document.body).backgroundColor")
    light = [int(part) > 200 for part in paper.removeprefix("rgb(").rstrip(")").split(",")]
    assert light == [not dark] * 3
    assert tab.value("performance.getEntriesByType('resource').length") == 0  # nothing is fetched


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_use_it(tab, address, width, dark):
    assert violations(tab, address, width, dark=dark) == []
    made, there = reached_by_tab(tab)
    # one radio button of a group is a stop, the others are reached by arrow keys
    radios = tab.value("document.querySelectorAll('input[type=radio]').length")
    assert made >= there - max(radios - 1, 0) > 4


def test_arrow_keys_turn_the_arm(tab, address):
    tab.look(address)
    tab.wait(DRAWN)
    picture = "document.querySelector('#arm canvas').toDataURL()"
    tab.value("document.querySelector('#arm canvas').focus()")
    seen = [tab.value(picture)]
    for key in ("ArrowLeft", "ArrowUp", "ArrowRight", "ArrowDown"):
        tab.ask("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
        seen.append(tab.value(picture))
    assert len({*seen[:-1]}) == 4
    assert tab.value("scrollY") == 0  # the page stays where it is
    assert tab.errors == []


LONG = """<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 .2">
 <joint name="lift" axis="0 1 0" range="-2 2"/>
 <geom type="capsule" fromto="0 0 0 .5 0 0" size=".045"/><body pos=".5 0 0">
  <joint name="stick" axis="0 1 0" range="-2 2"/>
  <geom type="capsule" fromto="0 0 0 .4 0 0" size=".04"/></body></body></worldbody></mujoco>"""
AT_THE_EDGES = """(() => {
  const seen = document.querySelector("#arm canvas"), flat = document.createElement("canvas");
  const { width, height } = Object.assign(flat, { width: seen.width, height: seen.height });
  const drawn = flat.getContext("2d");
  drawn.drawImage(seen, 0, 0);
  const opaque = (...box) =>
    drawn.getImageData(...box).data.filter((alpha, k) => k % 4 === 3 && alpha).length;
  return [opaque(0, 0, width, height), opaque(0, 0, 1, height), opaque(width - 1, 0, 1, height),
          opaque(0, 0, width, 1), opaque(0, height - 1, width, 1)];
})()"""


def test_all_of_an_arm_is_seen_not_its_joints_alone(tab, tmp_path):
    (tmp_path / "arm.xml").write_text(LONG)
    time = np.linspace(0.0, 9.0, 10)
    motion = PlayedMotion(time, np.outer(time - 4.5, [0.4, 0.2]), (), (), "A motion.")
    view = arm_view(RobotModel.load(tmp_path / "arm.xml"), np.array([-0.8, 0.4]), motion=motion)
    Page("An arm", arm_section(view, "The arm", "Drag."), arm=view).save(tmp_path / "arm.html")
    tab.look((tmp_path / "arm.html").as_uri())
    tab.wait("document.body.dataset.arm === 'drawn'")
    for row in range(10):
        slide = f"at.value = {row}; at.dispatchEvent(new Event('input'))"
        tab.value(f"{{ const at = document.querySelector('#arm [type=range]'); {slide}; }}")
        inside, *edges = tab.value(AT_THE_EDGES)
        assert inside > 1000
        assert edges == [0, 0, 0, 0]


def test_the_slider_moves_the_arm_and_the_line_in_the_chart(tab, address):
    tab.look(address)
    tab.wait(DRAWN)
    seen = [_at(tab, row) for row in (10, 55, 150)]
    assert [text for text, _, _ in seen] == ["1.01 s", "5.53 s, pushed by 13.0 N", "15.08 s"]
    lines = [line for _, line, _ in seen]
    assert lines == sorted(lines)
    assert len({picture for _, _, picture in seen}) == 3
    assert tab.errors == []


def _at(tab, row):
    """Return what is said, where the line stands, and the picture, at a row of the motion."""
    return tab.value(
        f"""(() => {{
        const slider = document.querySelector("#arm input[type=range]");
        slider.value = {row};
        slider.dispatchEvent(new Event("input"));
        const line = document.querySelector(".chart .cursor");
        return [document.querySelector("#arm output").textContent, parseFloat(line.style.left),
                document.querySelector("#arm canvas").toDataURL()];
        }})()"""
    )


def test_colours_and_ghosts_can_be_chosen(tab, address):
    tab.look(address)
    tab.wait(DRAWN)
    choose = "document.querySelector('#arm input[value=\"{}\"]').click()"
    shown = [_at(tab, 30)[2]]
    for value in ("now given", "now improved"):
        tab.value(choose.format(value))
        shown.append(tab.value("document.querySelector('#arm canvas').toDataURL()"))
    assert len(set(shown)) == 3
    tab.value("document.querySelector('#arm input[name=ghost]').click()")
    assert tab.value("document.querySelector('#arm canvas').toDataURL()") != shown[-1]


def test_without_webgl_there_is_the_picture(tab, address):
    source = "HTMLCanvasElement.prototype.getContext = () => null"
    added = tab.ask("Page.addScriptToEvaluateOnNewDocument", source=source)
    tab.look(address)
    tab.wait("document.body.dataset.arm === 'flat'")
    tab.ask("Page.removeScriptToEvaluateOnNewDocument", identifier=added["identifier"])
    assert tab.value("document.querySelector('.still').getBoundingClientRect().height") > 100


def test_paper_shows_the_picture_and_the_chart(tab, address, tmp_path):
    tab.look(address)
    tab.wait(DRAWN)
    tab.paper(tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
    tab.ask("Emulation.setEmulatedMedia", media="print")
    assert tab.value("getComputedStyle(document.querySelector('#arm canvas')).display") == "none"
    assert tab.value("document.querySelector('.still').getBoundingClientRect().height") > 100
    tab.ask("Emulation.setEmulatedMedia", media="")


@pytest.mark.skipif(firefox_program() is None, reason="no Firefox is installed on this machine")
@pytest.mark.parametrize("width", [1400, 390])
def test_it_draws_in_firefox_too(address, width):
    with firefox() as fox:
        fox.look(address, width)
        fox.wait("document.body.dataset.charts === 'drawn' && document.body.dataset.arm")
        assert fox.value("document.documentElement.scrollWidth") <= width
        assert fox.value("document.querySelectorAll('.chart svg.main-svg').length") > 0
        # a machine without a screen may have no WebGL: then the picture for paper is shown
        shown = ".stage canvas" if fox.value("document.body.dataset.arm") == "drawn" else ".still"
        assert fox.value(f"document.querySelector('{shown}').getBoundingClientRect().height") > 100
        assert [said for said in fox.errors if "WebGL" not in said] == []


@pytest.fixture(scope="module")
def looked_at(tmp_path_factory):
    """Return the address of a page of curves that the arm follows."""
    time = np.linspace(0.0, 20.0, 5000)
    curves = tuple(
        Curve(
            f"joint {j + 1}", f"q{j}", "position [rad]", "q [rad]", np.sin(time + j), is_drawn=True
        )
        for j in range(N)
    )
    odd = Curve("load <b>", "load <b>", "load", "not understood", time**2)
    left_out = (LeftOutRows("held", np.arange(900, 905)),)
    rows = np.delete(np.arange(time.size), left_out[0].rows)
    drawn = Curves(time, rows, (*curves, odd), left_out, pose=tuple(range(N)))
    view = arm_view(RobotModel.load("iiwa14"), np.zeros(N))
    stage = '<div class="stage"><svg class="leaders" aria-hidden="true"></svg></div>'
    body = "<h1>Curves</h1>" + curves_section(drawn, stage)
    path = tmp_path_factory.mktemp("look") / "look.html"
    Page("Curves", body, arm=view, curves=drawn).save(path)
    return path.as_uri()


CURVES = "document.body.dataset.arm === 'drawn' && document.body.dataset.curves === 'drawn'"
SPAN = "plot._fullLayout.xaxis.range.map((t) => Math.round(100 * t) / 100)"  # `plot` is an id
NAMES = "plot.data.map((line) => line.hovertemplate.split(':')[0])"
PUT = "el('{0}').value = '{1}'; el('{0}').dispatchEvent(new Event('input'))"
CLICK = "el('{}').click()"


def test_columns_are_chosen_zoomed_and_followed_by_the_arm(tab, looked_at):
    tab.look(looked_at, 1400, 900)
    tab.wait(CURVES)
    picture = "document.querySelector('#arm canvas').toDataURL()"
    before = tab.value(picture)
    tab.value(PUT.format("when", 5))
    assert tab.value("el('at').textContent") == "5.000 s"
    value = tab.value("document.querySelector('#columns td.n').textContent")
    assert value.startswith("\N{MINUS SIGN}0.95")  # sin 5
    assert tab.value(picture) != before
    tab.value(CLICK.format("in"))
    tab.wait(f"{SPAN}[1] < 20")
    low, high = tab.value(SPAN)
    assert low < 5 < high
    tab.value(CLICK.format("whole"))
    tab.wait(f"{SPAN}[1] === 20")
    tab.value(PUT.format("filter", "load"))
    tab.value(CLICK.format("only"))
    tab.wait(f"{NAMES}.length === 2")  # the curve, and its rows that were left out
    assert tab.value(NAMES)[0] == "load &lt;b> (load &lt;b>)"
    assert tab.errors == []


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)])
def test_everybody_can_look_at_columns(tab, looked_at, width, dark):
    assert violations(tab, looked_at, width, dark=dark, ready=CURVES) == []
    assert tab.value("performance.getEntriesByType('resource').length") == 0
