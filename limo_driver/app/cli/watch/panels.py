"""The panel of one service, from its status."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from limo_driver.quoting import in_line

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

STALE = 3.0  # [s] without status, after which a service is shown as silent
_WIDEST = 500  # characters of a line
_BARS = " ▁▂▃▄▅▆▇█"
_PER_BAR = 10  # bins of the latency histogram in one bar


def arm_panel(status: dict[str, Any], age: float) -> RenderableType:
    """Return what is shown of a service; an error where its status is no status.

    Args:
        status: As it was received.
        age: Since then [s].
    """
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    title = Text(printable(f"{status['arm']}: {status.get('state', '')}"))
    if age > STALE:
        return Panel(Text(f"silent for {age:.0f} s", style="red"), title=title)
    if status.get("state") != "serving":
        text = printable(str(status["state"]))
        bad = text.startswith(("silent", "refused"))
        return Panel(Text(text, style="red" if bad else "yellow"), title=title)
    facts = Table.grid(padding=(0, 2))
    arrivals, latency = status["arrivals"], status["latency"]
    facts.add_row("model", Text(printable(_model(status))))
    if "retraining" in status:
        facts.add_row("retraining", Text(printable(_retraining(status["retraining"]))))
    facts.add_row(
        "rate", f"{status['rate']:g} Hz, {status['answered']:d} answered in the last second"
    )
    losses = {k: v for k, v in arrivals.items() if k != "received"}
    facts.add_row("losses", _counts(losses))
    facts.add_row("counts", _counts({k: v for k, v in status["counts"].items() if v}))
    if latency["count"]:
        facts.add_row(
            "latency",
            f"p50 {1e3 * latency['p50']:.2f}  p99 {1e3 * latency['p99']:.2f}  "
            f"longest {1e3 * latency['longest']:.2f} ms   {_bars(latency['counts'])}",
        )
    if "log" in status:
        facts.add_row("log", _log(status["log"]))
    return Panel(Group(facts, _joints(status)), title=title, title_align="left")


def _counts(counts: dict[str, Any]) -> Text:
    from rich.text import Text

    return Text(printable(", ".join(f"{value:d} {name}" for name, value in counts.items()) or "-"))


def _log(log: dict[str, Any]) -> Text:
    from rich.text import Text

    written = f"{log['written']:d} written, {log['dropped']:d} dropped"
    if log["failure"] is None:
        return Text(written)
    return Text(printable(f"stopped: {log['failure']}; {written}"), style="red")


def _model(status: dict[str, Any]) -> str:
    return f"{status['model']}, {1e3 * status['delay']:.0f} ms behind"


def _retraining(facts: dict[str, Any]) -> str:
    """Return the stage, and what is known of it."""
    parts = [str(facts["stage"])]
    if "challenger" in facts:
        parts.append(f"challenger {facts['challenger']}")
    parts += [str(facts[name]) for name in ("reason", "verdict") if name in facts]
    if "left" in facts:
        parts.append(f"{facts['left']:.0f} s to go")
    if "judged" in facts:
        parts.append(f"{facts['judged']:.0f} s judged")
    return ", ".join(parts)


def _joints(status: dict[str, Any]) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    table = Table("joint", "external rms [N m]", "outside", "contact", box=None)
    rows = zip(status["external_rms"], status["outside"], status["contact"], strict=False)
    for j, (rms, outside, contact) in enumerate(rows, start=1):
        part = outside / max(status["answered"], 1)
        table.add_row(
            str(j),
            "-" if rms is None else f"{rms:.3f}",
            f"{100 * part:.0f} %",
            Text("contact", style="bold yellow") if contact else "",
        )
    return table


def _bars(counts: list[int]) -> str:
    """Return the histogram as characters, from where it begins to where it ends."""
    sums = [sum(counts[k : k + _PER_BAR]) for k in range(0, len(counts), _PER_BAR)]
    filled = [k for k, value in enumerate(sums) if value]
    if not filled:
        return ""
    shown = sums[filled[0] : filled[-1] + 1]
    return "".join(_BARS[math.ceil(8 * math.log1p(v) / math.log1p(max(shown)))] for v in shown)


def printable(text: str) -> str:
    """Return the beginning of a text, without what a terminal would obey."""
    return in_line(text[:_WIDEST])
