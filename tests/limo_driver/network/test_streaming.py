"""Keys, counting of arrivals, and joint states between two real Zenoh sessions."""

import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from sessions import PATIENCE, configurations_of_two, wait_until

from limo_driver.errors import ConfigError, ConnectionLostError
from limo_driver.network.messages import Attachment, decode_joint_state
from limo_driver.network.streaming import (
    Arrivals,
    JointStatePublisher,
    Keys,
    Presence,
    declare_history,
    follow_history,
    is_alive,
    open_session,
)
from limo_driver.robot.realtime import LatencyHistogram
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointState

pytestmark = pytest.mark.waits


def state(sequence, *, stale=False):
    values = np.array([0.1, -0.2]) * (sequence + 1)
    return JointState(0.001 * sequence, values, 2 * values, 3 * values, sequence, stale=stale)


class TestKeys:
    def test_name_the_places_of_one_arm(self):
        keys = Keys("left.arm-1")
        assert keys.joints == "limo/left.arm-1/state/joints"
        assert keys.model("load") == "limo/left.arm-1/model/load"

    @pytest.mark.parametrize("name", ["", "a/b", "a*", "$x", "a b", "ä", "**"])
    def test_refuse_what_cannot_be_part_of_a_key(self, name):
        with pytest.raises(ConfigError, match="expected letters, digits"):
            Keys(name)


class TestArrivals:
    def test_a_late_sample_is_no_longer_lost(self):
        arrivals = Arrivals()
        assert [arrivals.take(k, 10 * k) for k in (0, 1, 4, 2, 5)] == [1, 1, 1, 0, 1]
        assert arrivals.counts == {
            "received": 4, "lost": 1, "late": 1, "duplicated": 0, "restarts": 0
        }  # fmt: skip

    def test_a_duplicate_is_not_late(self):
        arrivals = Arrivals()
        assert [arrivals.take(k, 10 * k) for k in (0, 1, 1, 0)] == [1, 1, 0, 0]
        assert arrivals.counts["duplicated"] == 2

    def test_a_source_that_began_anew_is_followed(self):
        arrivals = Arrivals()
        assert [arrivals.take(*x) for x in ((7, 70), (8, 80), (0, 500), (1, 510))] == [1, 1, 1, 1]
        assert arrivals.counts["restarts"] == 1
        assert arrivals.counts["lost"] == 0

    def test_a_source_whose_clock_was_set_back_is_followed_after_a_while(self):
        arrivals = Arrivals()
        arrivals.take(10**9, 10**18)
        taken = [arrivals.take(k, 10 * k) for k in range(1, 151)]
        assert taken == [False] * 100 + [True] * 50
        assert arrivals.counts["restarts"] == 1

    def test_old_samples_that_do_not_follow_each_other_are_no_source(self):
        arrivals = Arrivals()
        arrivals.take(1000, 1000)
        assert not any(arrivals.take(k % 50, k % 50) for k in range(500))

    @given(st.permutations(list(range(12))), st.lists(st.integers(0, 11), max_size=5))
    def test_every_sample_is_counted_once(self, order, again):
        arrivals = Arrivals()
        for sequence in [*order, *again]:
            arrivals.take(sequence, sequence)
        before_first = order[0]  # that nothing was missed before the first is taken for granted
        counts = arrivals.counts
        assert counts["received"] + counts["late"] + counts["duplicated"] == 12 + len(again)
        assert counts["lost"] == 0
        assert counts["duplicated"] == before_first + len(again)


class TestLatencyHistogram:
    def test_percentiles_are_good_to_a_bin(self):
        histogram = LatencyHistogram()
        values = np.random.default_rng(0).lognormal(-8.0, 1.0, 5000)
        for value in values:
            histogram.add(value)
        for percent in (50, 99):
            assert histogram.percentile(percent) == pytest.approx(
                np.percentile(values, percent), rel=0.06
            )
        assert histogram.longest == values.max()

    def test_nothing_counted_has_no_percentile(self):
        assert np.isnan(LatencyHistogram().percentile(50))
        assert LatencyHistogram().as_json() == {"count": 0}

    def test_extremes_are_kept_in_the_outer_bins(self):
        histogram = LatencyHistogram()
        for value in (0.0, 1e9):
            histogram.add(value)
        assert histogram.count == 2
        assert histogram.percentile(100) <= 1e9

    def test_taking_begins_anew(self):
        histogram = LatencyHistogram()
        histogram.add(1.0)
        assert histogram.take().count == 1
        assert histogram.count == 0
        assert histogram.longest == 0.0


class TestSessions:
    def test_refuse_a_file_that_is_no_configuration(self, tmp_path):
        path = tmp_path / "zenoh.json5"
        path.write_text("{ listen: ")
        with pytest.raises(ConfigError, match=r"zenoh\.json5: is no Zenoh configuration"):
            open_session(config=path)

    def test_refuse_an_endpoint_that_is_none(self):
        with pytest.raises(ConfigError) as refused:
            open_session(connect=["nonsense"])
        assert str(refused.value) == (
            "endpoint nonsense: Endpoints must be of the form "
            "<protocol>/<address>[?<metadata>][#<config>]: nonsense"
        )

    def test_say_where_a_file_is_wrong(self, tmp_path):
        path = tmp_path / "zenoh.json5"
        path.write_text("{\n  mode: 'x'\n}")
        with pytest.raises(ConfigError) as refused:
            open_session(config=path)
        assert str(refused.value).endswith("`router`, `peer`, `client` (line 2, column 9)")

    def test_refuse_an_address_that_is_taken(self):
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
            with pytest.raises(ConnectionLostError, match=endpoint) as refused:
                open_session(listen=[endpoint])
        assert "Address already in use" in str(refused.value)
        assert ".rs" not in str(refused.value)  # nor where Zenoh was built


class TestPublishing:
    def test_states_arrive_as_they_were_measured(self, two_sessions):
        first, second = two_sessions
        got = []
        subscriber = second.declare_subscriber(
            Keys("arm").joints, lambda s: got.append((s.payload.to_bytes(), s.attachment))
        )
        with JointStatePublisher(first, "arm", ["a", "b"]) as publisher:
            probe = first.declare_publisher(Keys("arm").joints)
            wait_until(lambda: probe.matching_status.matching)
            for k in range(50):
                publisher.publish(state(k, stale=k == 49))
                wait_until(lambda number=k + 1: len(got) == number)  # best effort: one by one
        subscriber.undeclare()
        message = decode_joint_state(got[7][0])
        assert message.names == ("a", "b")
        np.testing.assert_array_equal(message.torque, state(7).torque)
        attachments = [Attachment.decode(attachment.to_bytes()) for _, attachment in got]
        assert [a.sequence for a in attachments] == list(range(50))
        assert [a.stale for a in attachments] == [False] * 49 + [True]
        stamps = np.array([decode_joint_state(payload).stamp_ns for payload, _ in got])
        np.testing.assert_array_equal(np.diff(stamps), 1_000_000)
        assert abs(stamps[0] - time.time_ns()) < 60e9

    def test_a_second_driver_of_the_same_name_is_refused(self, two_sessions):
        first, second = two_sessions
        with JointStatePublisher(first, "arm", ["a"]):
            wait_until(lambda: is_alive(second, Keys("arm").alive("driver")))
            with pytest.raises(ConfigError, match=r"another driver .* 'arm' is on the network"):
                JointStatePublisher(second, "arm", ["a"])
            JointStatePublisher(second, "other", ["a"]).close()

    def test_of_two_drivers_that_begin_together_one_stays(self, two_sessions):
        refused, open_ = [], []

        def begin(session):
            try:
                open_.append(JointStatePublisher(session, "arm", ["a"]))
            except ConfigError as error:
                refused.append(error)

        threads = [threading.Thread(target=begin, args=(s,)) for s in two_sessions]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert (len(open_), len(refused)) == (1, 1)
        open_[0].close()

    def test_who_comes_late_hears_what_was_told(self, two_sessions):
        first, second = two_sessions
        publisher = declare_history(first, Keys("arm").event)
        for k in range(3):
            publisher.put(str(k))
        heard, all_three = [], threading.Event()

        def hear(sample: zenoh.Sample) -> None:
            heard.append(sample.payload.to_string())
            if len(heard) == 4:
                all_three.set()

        subscriber = follow_history(second, Keys.of_any().event, hear)
        wait_until(lambda: len(heard) == 3)
        publisher.put("3")
        assert all_three.wait(PATIENCE)
        assert heard == ["0", "1", "2", "3"]
        subscriber.undeclare()


class TestPresence:
    @pytest.mark.slow("opens three sessions that look for each other")
    def test_of_a_second_service_of_an_arm_is_refused(self, tmp_path):
        here, there = configurations_of_two(tmp_path)
        with Presence(["left", "arm"], "service", config=here) as first:
            session = first.session()
            wait_until(lambda: is_alive(session, Keys("left").alive("service")))
            with (
                Presence(["arm"], "service", config=there) as second,
                pytest.raises(ConfigError, match="another service of an arm called 'arm'"),
            ):
                second.session()
            with Presence(["arm"], "driver", config=there) as driver:
                wait_until(lambda: is_alive(driver.session(), Keys("arm").alive("service")))
                wait_until(lambda: is_alive(session, Keys("arm").alive("driver")))

    def test_one_of_two_stays_whatever_the_order_of_their_arms(self, tmp_path):
        here, there = configurations_of_two(tmp_path)
        with (
            Presence(["left", "right"], "service", config=here) as one,
            Presence(["right", "left"], "service", config=there) as other,
        ):
            refused = []
            for presence in (one, other):
                try:
                    presence.session()
                except ConfigError as error:
                    refused.append(str(error))
            assert len(refused) == 1
            assert "'left'" in refused[0]

    @pytest.mark.slow("opens three sessions that look for each other")
    def test_ends_where_nobody_waited_for_it(self, tmp_path):
        here, there = configurations_of_two(tmp_path)
        with open_session(config=there) as other:
            with Presence(["arm"], "service", config=here):
                pass
            wait_until(lambda: not is_alive(other, Keys("arm").alive("service")))
            with Presence(["arm"], "service", config=here) as again:  # whose address is free again
                again.session()
                wait_until(lambda: is_alive(other, Keys("arm").alive("service")))

    def test_says_why_there_is_none(self):
        with Presence(["arm"], "service", connect=["nonsense"]) as presence:
            wait_until(presence._joined.done)
            for ask in (presence.check, presence.session):
                with pytest.raises(ConfigError, match="endpoint nonsense"):
                    ask()
        with pytest.raises(ConfigError, match="expected letters, digits"):
            Presence(["a/b"], "service")


class TestRunning:
    def test_a_run_is_published_in_real_time(self, limo, tmp_path):
        here, there = configurations_of_two(tmp_path)
        trajectory = tmp_path / "limo.traj.parquet"
        t = np.linspace(0.0, 1.0, 251)
        still = np.zeros((251, 7))
        position = np.tile([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0], (251, 1))
        Trajectory(t, position, still, still, robot="iiwa14").save(trajectory)
        got = []
        with open_session(config=here) as session:
            subscriber = session.declare_subscriber(
                Keys("left").joints,
                lambda s: got.append((Attachment.decode(s.attachment.to_bytes()), time.time_ns())),
            )
            began = time.time_ns()
            done = limo(
                "run", "--backend", "virtual", "--trajectory", trajectory, "--rate", 100,
                "--record", tmp_path / "run.parquet", "--stream", "--name", "left",
                "--zenoh-config", there,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            # What is published is best effort: a busy machine may lose some.
            wait_until(lambda: got and got[-1][0].sequence > 50)
            subscriber.undeclare()
        sequences = np.array([about.sequence for about, _ in got])
        stamps = np.array([about.stamp_ns for about, _ in got])
        assert (np.diff(sequences) > 0).all()
        np.testing.assert_array_equal(np.diff(stamps), 10_000_000 * np.diff(sequences))
        heard = np.array([arrived for _, arrived in got])
        assert (heard - began >= 10_000_000 * sequences).all()  # no state before its time


def test_one_endpoint_is_as_good_as_a_list_of_one():
    for endpoints in ("nonsense", ["nonsense"]):
        with pytest.raises(ConfigError, match=r"^endpoint nonsense:"):
            open_session(connect=endpoints)


def test_a_computer_without_shared_memory_has_sessions_all_the_same():
    """In a mount namespace of its own, where nothing can be written to /dev/shm."""
    code = (
        "from limo_driver.network.streaming import open_session\n"
        "with open_session(listen='tcp/127.0.0.1:0') as session: print(session.is_closed())"
    )
    mounted = 'mount -t tmpfs -o ro none /dev/shm && exec "$0" "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", mounted, sys.executable]
    if subprocess.run([*command, "-c", ""], capture_output=True, check=False).returncode:
        pytest.skip("no mount namespace can be made here")
    ended = subprocess.run([*command, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.stdout, ended.returncode) == ("False\n", 0), ended.stderr


def test_a_process_ends_with_no_thread_in_zenoh():
    """Python would end such a thread inside Zenoh's code, which then aborts the process."""
    code = """
import atexit, threading
atexit.register(lambda: print([x.name for x in threading.enumerate()]))
from limo_driver.network.streaming import open_session
open_session(listen="tcp/127.0.0.1:0").close()
"""
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.stdout, ended.returncode) == ("['MainThread']\n", 0), ended.stderr
