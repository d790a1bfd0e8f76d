"""Pages: what commands show in a browser, one HTML file each that needs no network.

`markup` has the pieces of a text and `figures` those of charts; `Page` puts them into one file with
the arm in 3-D. `arm` is the geometry that is drawn, `motion` a motion that it plays. What is said
on a page stands beside what it is said of: `limopa/page.py`, `estimators/evaluation_page.py` and so
on. `static/vendor` holds the two libraries that draw, plotly.js and three.js, with their licences.
"""

from __future__ import annotations

import gzip
from base64 import b64encode
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from limo_driver.model.units import unit_of
from limo_driver.pages.arm import ArmView, Ghost, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.markup import Charts, script_json
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.pages.figures import Curves


__all__ = ["ArmView", "Charts", "Ghost", "Page", "Pin", "PlayedMotion", "PushArrow", "arm_view"]


@dataclass(frozen=True)
class Page:
    """The content of a page; `html` is all of it as text."""

    title: str
    body: str  # HTML
    charts: Charts = field(default_factory=Charts)
    arm: ArmView | None = None  # drawn in the place of `arm_section`, or with curves
    curves: Curves | None = None  # drawn in the place of `curves_section`
    footer: str = ""  # HTML, behind the units
    sliding: Sequence[bool] = ()  # which joints of the arm slide, (n,)
    player: str = "player.js"  # the script that moves the arm

    def html(self) -> str:
        """Return the page as HTML."""
        has_charts = self.charts.figures or self.curves
        libraries = [("plotly", "plotly-cartesian.min.js")] if has_charts else []
        scripts = ["page.js", "charts.js"]
        if self.arm is not None:
            libraries.append(("three", "three.min.js"))
            scripts += ["arm.js", *([] if self.curves else [self.player])]
        if self.curves is not None:
            scripts.append("curves.js")
        return Template(asset("page.html")).substitute(
            title=escape(self.title),
            style=asset("style.css"),
            body=self.body,
            footer=f"{self._units()} {self.footer}".rstrip(),
            figures=self.charts.as_json(),
            arm=script_json(self.arm.as_values() if self.arm else None),
            curves=script_json(self.curves.as_values() if self.curves else None),
            libraries="\n".join(
                f'<script type="text/plain" id="library-{name}">{_packed(file)}</script>'
                for name, file in libraries
            ),
            script="\n".join(asset(name) for name in scripts),
        )

    def _units(self) -> str:
        far = "positions" if any(self.sliding) else "angles"
        torque, turn = (unit_of(unit, self.sliding) for unit in ("N m", "rad"))
        return f"Torque in {torque}, {far} in {turn}, joints counted from 1."

    def save(self, path: Path) -> None:
        """Write the page.

        Raises:
            ConfigError: It cannot be written.
        """
        with whole(path) as draft:
            draft.write_text(self.html(), encoding="utf-8")


def asset(name: str) -> str:
    """Return a file of `static`."""
    return (files("limo_driver.pages") / "static" / name).read_text(encoding="utf-8")


@cache
def _packed(name: str) -> str:
    """Return a library as browsers unpack it: a third of its size."""
    text = asset(f"vendor/{name}").encode("utf-8")
    return b64encode(gzip.compress(text, mtime=0)).decode()
