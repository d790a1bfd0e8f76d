"""Layouts name what a log really holds, in the form that Foxglove and PlotJuggler read."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree as ET

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from limo_driver.app.cli.convert import command
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.mcap_file import LoggedMessage, McapWriter
from limo_driver.logs.ros.layouts import foxglove_layout, logged_topics, plotjuggler_layout
from limo_driver.network.claims import Keys
from limo_driver.network.messages import (
    JOINT_STATE,
    LOG,
    TORQUE_ESTIMATE,
    Event,
    JointStateCodec,
    Level,
    TorqueEstimateCodec,
)
from limo_driver.recordings.recording import Recording

NAMES = ("shoulder", "elbow", "wrist")
# Foxglove's grammar of message paths, without filters and functions
PATH = re.compile(
    r'(?:"(?P<quoted>[^"]+)"|(?P<plain>/?[\w-]+(?:/[\w-]*)*))\.(?P<field>\w+)\[(?P<at>\d+)\]'
)


def write(path, arm="left", estimates=True):
    keys, writer = Keys(arm), McapWriter(path)
    zero, no = np.zeros(3), np.zeros(3, dtype=bool)
    told = [(keys.joints, JOINT_STATE, JointStateCodec(NAMES).encode(1, zero, zero, zero))]
    if estimates:
        estimate = TorqueEstimateCodec(NAMES).encode(1, zero, zero, zero, no, model="1")
        event = Event(1, Level.INFO, "contact", "a push", {}).encode()
        told += [(keys.estimate, TORQUE_ESTIMATE, estimate), (keys.event, LOG, event)]
    for k, (topic, schema, payload) in enumerate(told):
        writer.add(LoggedMessage(topic, schema, payload, k + 1, k + 1, k))
    writer.finish()
    return path


def fields(path):
    """Return the array fields of each topic of a log, from the schema that it holds."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    return {
        channel.topic: set(
            re.findall(r"\[\] (\w+)", summary.schemas[channel.schema_id].data.decode())
        )
        for channel in summary.channels.values()
    }


def leaves(tree):
    if isinstance(tree, str):
        return [tree]
    assert tree["direction"] in {"row", "column"}
    assert 0 < tree["splitPercentage"] < 100
    return leaves(tree["first"]) + leaves(tree["second"])


@pytest.mark.parametrize("arm", ["left", "cell-2.left"])
def test_foxglove_finds_every_path_in_the_log(tmp_path, arm):
    path = write(tmp_path / "log.mcap", arm)
    layout = json.loads(foxglove_layout(logged_topics([path])))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels, known = layout["configById"], fields(path)
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    shown = [p["value"] for panel in panels.values() for p in panel.get("paths", [])]
    assert len(set(shown)) == len(shown) == 3 * len(NAMES)
    for value in shown:
        found = PATH.fullmatch(value)
        assert found, value
        assert found["field"] in known[found["quoted"] or found["plain"]]
        assert int(found["at"]) < len(NAMES)
    (events,) = [panel for name, panel in panels.items() if name.startswith("RosOut!")]
    assert events["topicToRender"] in known


def test_plotjuggler_finds_every_curve_in_the_log(tmp_path):
    path = write(tmp_path / "log.mcap")
    root = ET.fromstring(plotjuggler_layout(logged_topics([path])))  # noqa: S314  # our own
    joints, estimate = Keys("left").joints, Keys("left").estimate
    # as its parsers name series: joint states by joint, other arrays by index
    known = {f"{joints}/{name}/{of}" for name in NAMES for of in ("position", "velocity", "effort")}
    known |= {f"{estimate}/{of}[{j}]" for of in fields(path)[estimate] for j in range(len(NAMES))}
    assert {curve.get("name") for curve in root.iter("curve")} <= known
    check_window(root)
    assert len(list(root.iter("curve"))) == 5 * len(NAMES)


def check_window(root):
    (window,) = root.findall("tabbed_widget[@parent='main_window']")
    assert window.findall("Tab")
    for tab in window.findall("Tab"):
        (split,) = tab.findall("Container/DockSplitter")
        areas = split.findall("DockArea")
        assert split.get("count") == str(len(areas)) == str(len(split.get("sizes").split(";")))
        for area in areas:
            (plot,) = area.findall("plot[@mode='TimeSeries']")
            assert plot.findall("curve")


def test_a_log_without_estimates_shows_what_it_has(tmp_path):
    log = logged_topics([write(tmp_path / "log.mcap", estimates=False)])
    panels = json.loads(foxglove_layout(log))["configById"]
    assert [len(panel["paths"]) for panel in panels.values()] == [1, 1, 1]
    assert "estimate" not in plotjuggler_layout(log)


def test_convert_writes_them(commanded, tmp_path):
    log = write(tmp_path / "log.mcap")
    for name in ("foxglove.json", "plotjuggler.xml"):
        done = commanded(command)(log, "--out", tmp_path / name)
        assert done.exit_code == 0, done.output
        assert "3 joints of limo/left/state/joints" in done.output.replace("\n", " ")
    json.loads((tmp_path / "foxglove.json").read_text())
    check_window(ET.parse(tmp_path / "plotjuggler.xml").getroot())  # noqa: S314  # our own


def test_plotjuggler_shows_a_recording_by_its_columns(commanded, tmp_path):
    time = np.arange(100) / 100.0
    swing = np.sin(time)[:, None] * np.ones(3)
    Recording.from_arrays(time, swing, swing).save(tmp_path / "run.parquet")
    done = commanded(command)(tmp_path / "run.parquet", "--out", tmp_path / "layout.xml")
    assert done.exit_code == 0, done.output
    root = ET.parse(tmp_path / "layout.xml").getroot()  # noqa: S314  # our own
    check_window(root)
    shown = {curve.get("name") for curve in root.iter("curve")}
    assert (
        {"torque_3", "position_1"} <= shown <= set(pq.read_schema(tmp_path / "run.parquet").names)
    )
    refused = commanded(command)(tmp_path / "run.parquet", "--out", tmp_path / "layout.json")
    assert isinstance(refused.exception, ConfigError)
    assert "Foxglove opens logs" in str(refused.exception)
    (tmp_path / "none.parquet").write_text("no Parquet")
    refused = commanded(command)(tmp_path / "none.parquet", "--out", tmp_path / "none.xml")
    assert isinstance(refused.exception, RecordingError)


def test_a_log_without_joint_states_is_refused(tmp_path):
    writer = McapWriter(tmp_path / "log.mcap")
    writer.finish()
    with pytest.raises(RecordingError, match="no joint states"):
        logged_topics([tmp_path / "log.mcap"])
