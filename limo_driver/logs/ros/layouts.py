"""Layouts of Foxglove and PlotJuggler that show a log: torque of each joint, and what is left.

Sources: Foxglove's grammar of message paths; PlotJuggler's `parseJointStateMsg`, which names series
by joint, and its reader of layouts.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final, TypeAlias
from xml.etree import ElementTree as ET

from limo_driver.errors import RecordingError
from limo_driver.logs.ros.joint_state_log import messages_of
from limo_driver.network.messages import JOINT_STATE, TORQUE_ESTIMATE, decode_joint_state
from limo_driver.pages.figures import AFTER, JOINTS, MEASURED
from limo_driver.quoting import for_xml

_Plots: TypeAlias = "Sequence[tuple[str, Sequence[tuple[str, str]]]]"  # title; series, colours
_SEARCHED: Final = 50_000  # messages in which every topic of a log is heard
_ESTIMATE: Final = "torque/estimate"  # the end of its topic, as `Keys` has it
_PLAIN: Final = re.compile(r"/?[A-Za-z0-9_-]+(?:/[A-Za-z0-9_-]*)*")  # needs no quotes in a path


@dataclass(frozen=True)
class LoggedTopics:
    """The topics of one arm in a log."""

    joints: tuple[str, ...]
    states: str  # topic of its joint states
    estimates: str | None = None  # of limo's estimates, if the log has any

    @property
    def events(self) -> str | None:
        """The topic of limo's events."""
        known = self.estimates is not None and self.estimates.endswith(_ESTIMATE)
        return f"{(self.estimates or '').removesuffix(_ESTIMATE)}event" if known else None


def logged_topics(paths: Sequence[Path]) -> LoggedTopics:
    """Return the topics that a log holds; of several arms, those of the first that is heard.

    Args:
        paths: MCAP or .db3 files, or folders of them.

    Raises:
        RecordingError: They hold no joint states.
    """
    joints: tuple[str, ...] | None = None
    states = estimates = ""
    for message in islice(messages_of(paths), _SEARCHED):
        if message.schema == JOINT_STATE and joints is None:
            joints, states = tuple(decode_joint_state(message.payload).names), message.topic
        if message.schema == TORQUE_ESTIMATE and not estimates:
            estimates = message.topic
        if joints and estimates:
            break
    if joints is None:
        raise RecordingError("no joint states in these logs", path=paths[0])
    return LoggedTopics(joints, states, estimates or None)


def foxglove_layout(log: LoggedTopics) -> str:
    """Return a layout that Foxglove imports, as JSON."""
    panels: dict[str, Any] = {}
    for j, joint in enumerate(log.joints):
        paths = [_path(log.states, "effort", j, "measured", MEASURED)]
        if log.estimates:
            paths.append(_path(log.estimates, "torque", j, "estimated", AFTER))
        panels[f"Plot!joint{j + 1}"] = _plot(f"Torque of joint {j + 1}, {joint} [N m]", paths)
    columns = [_stacked(list(panels), "column")]
    if log.estimates:
        external = [
            _path(log.estimates, "external", j, joint, JOINTS[j % len(JOINTS)])
            for j, joint in enumerate(log.joints)
        ]
        panels["Plot!external"] = _plot("Measured less estimated torque [N m]", external)
        panels["RosOut!events"] = {"searchTerms": [], "minLogLevel": 1, "topicToRender": log.events}
        columns.append(_stacked(["Plot!external", "RosOut!events"], "column"))
    values = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stacked(columns, "row"),
    }
    return json.dumps(values, indent=1) + "\n"


def plotjuggler_layout(log: LoggedTopics) -> str:
    """Return a layout that PlotJuggler loads, as XML."""
    torques = [
        [
            (f"{log.states}/{joint}/effort", MEASURED),
            *([(f"{log.estimates}/torque[{j}]", AFTER)] if log.estimates else []),
        ]
        for j, joint in enumerate(log.joints)
    ]
    tabs: dict[str, _Plots] = {"torque": [*zip(log.joints, torques, strict=True)]}
    if log.estimates:
        series = [
            (f"{log.estimates}/external[{j}]", JOINTS[j % len(JOINTS)])
            for j in range(len(log.joints))
        ]
        tabs["measured less estimated"] = [("external torque", series)]
    for what in ("position", "velocity"):
        tabs[what] = [(joint, [(f"{log.states}/{joint}/{what}", AFTER)]) for joint in log.joints]
    return _window(tabs)


def recording_layout(columns: Sequence[str]) -> str:
    """Return a layout in which PlotJuggler shows a recording, as XML.

    Args:
        columns: Of its Parquet file: `position_1`, and so on; told positions beside measured ones.
    """
    tabs: dict[str, _Plots] = {}
    for what in ("torque", "position", "velocity"):
        plots = [
            (name, [*([(target, MEASURED)] if target in columns else []), (name, AFTER)])
            for name in columns
            if re.fullmatch(rf"{what}_\d+", name)
            for target in [f"target_{name}"]
        ]
        tabs |= {what: plots} if plots else {}
    return _window(tabs)


def _window(tabs: Mapping[str, _Plots]) -> str:
    """Return PlotJuggler's window of tabs by their names."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for name, plots in tabs.items():
        _tab(window, name, plots)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def _path(topic: str, field: str, j: int, label: str, colour: str) -> dict[str, Any]:
    named = topic if _PLAIN.fullmatch(topic) else json.dumps(topic)
    return {
        "value": f"{named}.{field}[{j}]",
        "enabled": True,
        "timestampMethod": "headerStamp",
        "label": label,
        "color": colour,
    }


def _plot(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": paths,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _stacked(items: Sequence[Any], direction: str) -> Any:  # noqa: ANN401  # a panel or a tree
    """Return panels side by side or one below the other, alike in size."""
    if len(items) == 1:
        return items[0]
    rest = _stacked(items[1:], direction)
    part = 100.0 / len(items)
    return {"direction": direction, "first": items[0], "second": rest, "splitPercentage": part}


def _tab(window: ET.Element, name: str, plots: _Plots) -> None:
    """Add a tab of plots, one below the other."""
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=name)
    split = ET.SubElement(
        ET.SubElement(tab, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(len(plots)),
        sizes=";".join([f"{1.0 / len(plots):.6f}"] * len(plots)),
    )
    for title, series in plots:
        area = ET.SubElement(split, "DockArea", name=for_xml(title))
        plot = ET.SubElement(
            area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
        )
        ET.SubElement(plot, "limitY")
        for curve, colour in series:
            ET.SubElement(plot, "curve", name=for_xml(curve), color=colour)
