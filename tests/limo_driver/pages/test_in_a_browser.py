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
from limo_driver.pages.arm_section import arm_section
from limo_driver.pages.markup import paragraph, table

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
