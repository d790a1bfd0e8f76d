"""The page: texts, charts, the arm in 3-D and what draws them, in one file without network."""

from __future__ import annotations

import gzip
from base64 import b64encode
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from limo_driver.pages.markup import Charts, script_json
from limo_driver.quoting import in_html as escape
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.pages.arm import ArmView
    from limo_driver.pages.figures import Curves

FOOTER = "Torque in N m, angles in rad, joints counted from 1."


@dataclass(frozen=True)
class Page:
    """The content of a page; `html` is all of it as text."""

    title: str
    body: str  # HTML
    charts: Charts = field(default_factory=Charts)
    arm: ArmView | None = None  # drawn in the place of `arm_section`, or with curves
    curves: Curves | None = None  # drawn in the place of `curves_section`
    footer: str = FOOTER  # HTML
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
            footer=self.footer,
            figures=self.charts.as_json(),
            arm=script_json(self.arm.as_values() if self.arm else None),
            curves=script_json(self.curves.as_values() if self.curves else None),
            libraries="\n".join(
                f'<script type="text/plain" id="library-{name}">{_packed(file)}</script>'
                for name, file in libraries
            ),
            script="\n".join(asset(name) for name in scripts),
        )

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
