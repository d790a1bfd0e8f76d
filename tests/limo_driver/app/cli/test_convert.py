"""`limo convert`: logs become recordings, and nothing odd about them goes unsaid."""

import json
import os
import re
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer
from rosbags import typesys

from limo_driver.app.cli import main
from limo_driver.logs.mcap_log import LogLimits, McapLog, log_files, read_mcap
from limo_driver.network.messages import JOINT_STATE, LOG, Event, JointStateCodec, Level
from limo_driver.recordings.files.recorder import read_header
from limo_driver.recordings.recording import Recording

NAMES = ("shoulder", "elbow")
TOPIC = "limo/two/state/joints"
START = 1_700_000_000_000_000_000
PERIOD = 5_000_000  # [ns]


def state(k):
    """Position, velocity and torque of a moving arm at sample k."""
    angle = 2 * np.pi * np.array([0.5, 0.7]) * k * PERIOD * 1e-9
    rate = 2 * np.pi * np.array([0.5, 0.7])
    return np.sin(angle), rate * np.cos(angle), 5 * np.cos(angle) + 1e-3 * (k % 7)


def payload(k, names=NAMES):
    return JointStateCodec(names).encode(START + k * PERIOD, *state(k))


@pytest.fixture
def log(tmp_path):
    """Write payloads as a log; returns its file."""

    def of(payloads, topic=TOPIC, name="limo"):
        with McapLog(tmp_path / "logs", name) as written:
            for k, data in enumerate(payloads):
                written.write(topic, JOINT_STATE, data, START + k, START + k, k)
        return log_files(tmp_path / "logs", name)[-1]

    return of


@pytest.fixture
def convert(tmp_path, monkeypatch, capsys):
    """Run `limo convert` in this process; returns exit status, stdout and stderr."""

    def run(*arguments, out="run.parquet"):
        given = map(str, (*arguments, "--out", tmp_path / out))
        monkeypatch.setattr(sys, "argv", ["limo", "convert", *given])
        with pytest.raises(SystemExit) as ended:
            main()
        return (ended.value.code or 0, *capsys.readouterr())

    return run


def test_a_log_becomes_a_recording(tmp_path, log, convert):
    status, said, notes = convert(log(map(payload, range(400))))
    assert (status, notes) == (0, "")
    assert f"run.parquet: 400 samples of 2 joints over 1.995 s, topic {TOPIC}" in said
    assert "messages" not in said
    recording = Recording.load(tmp_path / "run.parquet")
    expected = [np.array(values) for values in zip(*map(state, range(400)), strict=True)]
    np.testing.assert_array_equal(recording.position, expected[0])
    np.testing.assert_array_equal(recording.velocity, expected[1])
    np.testing.assert_array_equal(recording.torque, expected[2])
    np.testing.assert_allclose(recording.time, np.arange(400) * PERIOD * 1e-9, atol=1e-12)
    header = read_header(pq.read_table(tmp_path / "run.parquet"))
    assert header["joints"] == list(NAMES)
    assert header["provenance"]["topic"] == TOPIC
    assert header["provenance"]["start_ns"] == START


def test_what_is_odd_is_counted(tmp_path, log, convert):
    order = [*range(100), 103, 100, 101, 102, *range(104, 200), 150, *range(300, 400)]
    malformed = payload(0)[:-3]
    data = [payload(k) for k in order]
    path = log([*data[:50], malformed, *data[50:]])
    status, said, notes = convert(path)
    assert status == 0, notes
    assert "3 messages were logged after one with a later stamp" in said
    assert "1 messages could not be decoded" in said
    assert "1 row left out: the time does not increase (row 200)" in notes
    assert "1 gap; the longest, 0.505 s" in notes
    recording = Recording.load(tmp_path / "run.parquet")
    assert len(recording) == 300
    assert [part.stop - part.start for part in recording.segments] == [200, 100]
    np.testing.assert_array_equal(recording.position[101], state(101)[0])


def test_messages_without_a_stamp_have_the_times_of_their_receipt(tmp_path, convert):
    with McapLog(tmp_path / "logs") as written:
        for k in range(200):
            data = JointStateCodec(NAMES).encode(0, *state(k))
            written.write(TOPIC, JOINT_STATE, data, START + k * PERIOD, START + k * PERIOD, k)
    status, _, notes = convert(tmp_path / "logs")
    assert (status, "200 messages have no stamp (0): their times are those" in notes) == (0, True)
    time = Recording.load(tmp_path / "run.parquet").time
    np.testing.assert_allclose(time, np.arange(200) * PERIOD * 1e-9, atol=1e-12)


def test_counts_as_json(log, convert):
    status, said, _ = convert(log(map(payload, [*range(200), 199])), "--json")
    values = json.loads(said)
    assert status == 0
    assert (values["samples"], values["usable"], values["duplicates"]) == (201, 200, 1)
    assert values["joints"] == list(NAMES)


def test_rotated_files_and_a_cut_off_one_make_one_recording(tmp_path, convert):
    folder = tmp_path / "logs"
    with McapLog(folder, limits=LogLimits(file_seconds=0.01)) as written:
        for k in range(400):
            written.write(TOPIC, JOINT_STATE, payload(k), START, START, k)
            if k % 100 == 99:
                while written.written <= k:
                    pass
        written.write("events", LOG, Event(0, Level.INFO, "log", "").encode(), START, START)
    files = log_files(folder)
    assert len(files) >= 4
    os.truncate(files[1], 200)  # within its only chunk
    status, said, notes = convert(folder)
    assert status == 0, notes
    assert f"{files[1].name} was never finished" in notes
    assert " 300 samples" in said
    assert "1 gap; the longest, 0.505 s" in notes


def test_joints_are_those_of_the_robot_in_their_order(tmp_path, two_links_urdf, log, convert):
    other = JointStateCodec(["finger"]).encode(START, *[np.zeros(1)] * 3)
    path = log([*(payload(k, ("b", "a")) for k in range(200)), other])
    status, said, notes = convert(path, "--robot", two_links_urdf)
    assert status == 0, notes
    assert "1 messages lack joints of the robot" in said
    recording = Recording.load(tmp_path / "run.parquet")
    assert recording.robot == str(two_links_urdf)
    np.testing.assert_array_equal(recording.position[:, 1], [state(k)[0][0] for k in range(200)])
    status, _, notes = convert(path)
    assert (status, "of the joints b, a and of finger" in notes) == (2, True)
    status, _, notes = convert(path, "--robot", "iiwa14")
    assert (status, "has no positions of the 7 joints of iiwa14" in notes) == (2, True)
    assert "position.b" in notes


def test_joints_are_found_as_an_inspection_finds_them(tmp_path, two_links_urdf, log, convert):
    names = ("left_finger", "arm_b", "arm_a")
    values = [[np.insert(v, 0, 0.01 * k) for v in state(k)] for k in range(200)]
    codec = JointStateCodec(names)
    path = log(codec.encode(START + k * PERIOD, *own) for k, own in enumerate(values))
    status, said, notes = convert(path, "--robot", two_links_urdf)
    assert status == 0, notes
    assert "position position.arm_a, position.arm_b [rad]" in notes
    assert "left out: position.left_finger" in notes
    assert "200 samples of 2 joints" in said
    recording = Recording.load(tmp_path / "run.parquet")
    np.testing.assert_array_equal(recording.position[:, 0], [state(k)[0][1] for k in range(200)])
    header = read_header(pq.read_table(tmp_path / "run.parquet"))
    assert header["joints"] == ["a", "b"]


def test_joints_beside_those_of_the_robot_are_named(two_links_urdf, log, convert):
    values = [[np.insert(v, 0, 0.0) for v in state(k)] for k in range(200)]
    codec = JointStateCodec(("finger", "b", "a"))
    path = log(codec.encode(START + k * PERIOD, *own) for k, own in enumerate(values))
    status, _, notes = convert(path, "--robot", two_links_urdf)
    assert (status, "left out: finger" in notes) == (0, True)


def test_where_a_joint_is_that_a_bag_lacks_is_asked(two_links_urdf, log, convert):
    path = log(JointStateCodec(["a"]).encode(START + k, *np.ones((3, 1))) for k in range(200))
    status, _, notes = convert(path, "--robot", two_links_urdf)
    assert (status, "joint b changes what gravity asks" in notes) == (2, True)


@pytest.mark.parametrize("option", ["--robot", "--topic", "--mapping"])
def test_a_layout_takes_no_word_of_how_a_log_is_read(log, convert, option):
    status, _, notes = convert(log(map(payload, range(9))), option, "any", out="layout.xml")
    assert (status, f"takes no {option}" in notes) == (2, True)


def test_a_layout_of_another_kind_of_log_is_refused(tmp_path, convert):
    csv = tmp_path / "log.csv"
    csv.write_text("t,q0\n0,1\n")
    status, _, notes = convert(csv, out="layout.json")
    assert (status, "log.csv: a layout is of limo's logs" in notes) == (2, True)


def test_an_ending_that_is_not_known_is_refused(log, convert):
    status, _, notes = convert(log(map(payload, range(9))), "--robot", "iiwa14", out="run.xlsx")
    assert (status, "run.xlsx" in notes, ".parquet" in notes) == (2, True, True)


def test_several_topics_need_to_be_named(tmp_path, log, convert):
    log(map(payload, range(100)), "left", "one")
    log(map(payload, range(100, 300)), "right", "two")
    status, _, notes = convert(tmp_path / "logs")
    assert status == 2
    assert "joint states of several topics: left, right; say which is meant" in notes
    status, said, _ = convert(tmp_path / "logs", "--topic", "right")
    assert (status, "200 samples" in said) == (0, True)
    status, _, notes = convert(tmp_path / "logs", "--topic", "middle")
    assert status == 2
    assert "no joint states of topic middle in these logs; they hold left (sensor_msgs" in notes


def test_bag_of_another_writer(tmp_path, convert):
    """Messages by another serializer, without chunks, as `ros2 bag` may write them."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    types = store.types
    path = tmp_path / "bag_0.mcap"
    with path.open("wb") as file:
        bag = Writer(file, use_chunking=False)
        bag.start("ros2")
        definition, _ = store.generate_msgdef(JOINT_STATE)
        schema = bag.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = bag.register_channel("/joint_states", "cdr", schema)
        for k in range(300):
            stamp = types["builtin_interfaces/msg/Time"](*divmod(START + k * PERIOD, 10**9))
            header = types["std_msgs/msg/Header"](stamp, "base_link")
            position, _, effort = state(k)
            message = types[JOINT_STATE](header, list(NAMES), position, np.zeros(0), effort)
            data = bytes(store.serialize_cdr(message, JOINT_STATE))
            bag.add_message(channel, START + k, data, START + k)
        bag.finish()
    status, said, notes = convert(path)
    assert status == 0, notes
    assert "300 samples of 2 joints" in said
    recording = Recording.load(tmp_path / "run.parquet")
    assert recording.velocity is None
    np.testing.assert_array_equal(recording.torque, [state(k)[2] for k in range(300)])


@pytest.mark.parametrize(
    ("payloads", "message"),
    [
        ([], "no joint states in these logs; they hold nothing"),
        ([b"nonsense"], "no joint states in these logs; 1 are malformed; they hold limo/two"),
        ([payload(k) for k in range(10)], "has 10 usable rows of 10, expected at least 20"),
        (
            [payload(k) for k in (*range(100), *range(50))],
            "the time runs backwards at row 100, from 0.495 s to 0 s; are these two recordings",
        ),
        (
            [payload(k + 50 * (k % 2)) for k in range(200)],
            "run backwards at 50% of the messages; are these two publishers",
        ),
        (
            [
                JointStateCodec(NAMES).encode(START + k, state(k)[0], np.zeros(0), np.zeros(0))
                for k in range(50)
            ],
            "have no effort; a recording needs position and effort",
        ),
        ([JointStateCodec([]).encode(0, *[np.zeros(0)] * 3)], "does not name its joints"),
    ],
)
def test_logs_without_a_recording_in_them_are_refused(tmp_path, log, convert, payloads, message):
    status, _, notes = convert(log(payloads))
    assert status == 2
    assert re.search(message, notes), notes
    assert not (tmp_path / "run.parquet").exists()


def test_folder_without_logs_is_refused(tmp_path, convert):
    status, _, notes = convert(tmp_path)
    assert (status, "holds no .mcap, .db3 or .bag files" in notes) == (2, True)


def test_there_and_back(tmp_path, log, convert):
    convert(log(map(payload, range(200))))
    status, said, notes = convert(tmp_path / "run.parquet", out="back.mcap")
    assert status == 0, notes
    assert "200 samples of 2 joints over 0.995 s, topic /joint_states" in said
    messages = list(read_mcap(tmp_path / "back.mcap"))
    assert [message.payload for message in messages] == [payload(k) for k in range(200)]
    assert [message.log_time_ns for message in messages[:2]] == [START, START + PERIOD]
    status, _, notes = convert(tmp_path / "run.parquet", "--robot", "iiwa14", out="back.mcap")
    assert (status, "has 2 joints, but iiwa14 has 7" in notes) == (2, True)


def test_recording_of_unnamed_joints_becomes_a_log_of_numbered_ones(tmp_path, convert):
    time = np.arange(100) * 0.01
    wave = np.sin(time[:, None] * np.array([3.0, 4.0]))
    Recording(time, wave, 3 * wave, extras={"current": wave}).save(tmp_path / "run.parquet")
    status, said, notes = convert(tmp_path / "run.parquet", "--json", out="back.mcap")
    values = json.loads(said)
    assert (status, notes, values["joints"]) == (0, "", ["joint_1", "joint_2"])
    assert "current is left behind" in values["notes"]
