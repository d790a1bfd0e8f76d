"""Joint states as rmw_zenoh has them: key, token and attachment to the letter, and both ways."""

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore
from sessions import configurations_of_two, wait_until

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages import (
    Attachment,
    JointStateCodec,
    RosAttachment,
    decode_joint_state,
)
from limo_driver.network.ros import HASHES, RosNode, RosPublisher, RosReader, RosTopic, unlike
from limo_driver.network.streaming import JointStatePublisher, Keys, open_session
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointState

pytestmark = pytest.mark.waits

HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
KEY = f"3/joint_states/sensor_msgs::msg::dds_::JointState_/{HASH}"
GID = bytes(range(16))


class TestTopic:
    def test_has_the_key_of_rmw_zenoh(self):
        assert RosTopic(domain=3).key == KEY
        assert RosTopic("/joint_states", 3).key == KEY
        assert zenoh.KeyExpr(RosTopic(domain=3).key_of_any_hash).includes(KEY)

    def test_has_the_liveliness_token_of_rmw_zenoh(self):
        assert RosTopic("/left/joint_states", 7).token("a1b2") == (
            "@ros2_lv/7/a1b2/0/1/MP/%/%/limo/%left%joint_states/"
            f"sensor_msgs::msg::dds_::JointState_/{HASH}/::,10:,:,:,,"
        )

    def test_a_history_is_transient_local_and_has_a_depth(self):
        token = RosTopic("events", 0, "rcl_interfaces/msg/Log", kept=100).token("ab", 7)
        assert token.startswith("@ros2_lv/0/ab/0/7/MP/%/%/limo/%events/rcl_interfaces::msg::dds_::")
        assert token.endswith("/:1:,100:,:,:,,")

    @pytest.mark.parametrize("name", ["", "/", "a//b", "a/", "1a", "a-b", "a/*", "**", "a b"])
    def test_refuses_a_name_that_ros_has_not(self, name):
        with pytest.raises(ConfigError, match="expected letters, digits and '_' between slashes"):
            RosTopic(name)

    @pytest.mark.parametrize("domain", [-1, 233])
    def test_refuses_a_domain_that_ros_has_not(self, domain):
        with pytest.raises(ConfigError, match=rf"domain is {domain}, expected 0 to 232"):
            RosTopic(domain=domain)


@pytest.mark.parametrize("kind", HASHES)
def test_hashes_of_types_are_those_of_ros(kind):
    for version in (Stores.ROS2_JAZZY, Stores.ROS2_KILTED):
        assert HASHES[kind] == get_typestore(version).hash_rihs01(kind)


class TestSubscribersOfAnotherType:
    TOPIC = RosTopic("arm/wrench", 3, "geometry_msgs/msg/WrenchStamped")

    def token(self, kind="geometry_msgs::msg::dds_::WrenchStamped_", of=TOPIC.type, name="wrench"):
        return f"@ros2_lv/3/ab/0/4/MS/%/%/rviz/%arm%{name}/{kind}/{HASHES.get(of, of)}/::,10:,:,:,,"

    def test_one_line_says_what_it_expects(self):
        assert unlike(self.token(of="RIHS01_0"), [RosTopic(), self.TOPIC]) == (
            "node rviz hears nothing of arm/wrench: it expects "
            "geometry_msgs::msg::dds_::WrenchStamped_ of hash RIHS01_0, and gets "
            f"geometry_msgs::msg::dds_::WrenchStamped_ of {HASHES[self.TOPIC.type]}"
        )
        assert "expects std_msgs" in unlike(
            self.token("std_msgs::msg::dds_::String_"), [self.TOPIC]
        )

    def test_others_are_passed_over(self):
        publisher = self.token(of="RIHS01_0").replace("/MS/", "/MP/")
        for token in (self.token(), self.token(name="x", of="RIHS01_0"), publisher, "@ros2_lv/3"):
            assert unlike(token, [self.TOPIC]) == ""


class TestPublishing:
    def test_a_ros_subscriber_gets_the_bytes_of_the_native_key(self, two_sessions):
        first, second = two_sessions
        native, ros = [], []
        subscribers = [
            second.declare_subscriber(Keys("arm").joints, native.append),
            second.declare_subscriber(KEY, ros.append),
        ]
        topic = RosTopic(domain=3)
        with (
            RosPublisher(first, topic) as also,
            JointStatePublisher(first, "arm", ["a", "b"], also.publish) as publisher,
        ):

            def arrived():
                publisher.publish(state(7))
                return len(native) > 1 and len(ros) > 1

            wait_until(arrived)
            tokens = [
                str(reply.ok.key_expr)
                for reply in second.liveliness().get("@ros2_lv/**", timeout=60.0)
            ]
        for subscriber in subscribers:
            subscriber.undeclare()
        assert tokens == [topic.token(str(first.zid()))]
        payload = ros[0].payload.to_bytes()
        assert payload == native[0].payload.to_bytes()
        raw = ros[0].attachment.to_bytes()
        stamp = decode_joint_state(payload).stamp_ns
        assert len(raw) == 33
        assert raw[:17] == (
            (7).to_bytes(8, "little") + stamp.to_bytes(8, "little", signed=True) + b"\x10"
        )

    def test_a_node_has_a_token_of_its_own(self, two_sessions):
        first, second = two_sessions
        wanted = [RosTopic("a"), RosTopic("b")]
        zid = str(first.zid())
        own = {topic.token(zid, number) for number, topic in enumerate(wanted, 1)}

        def tokens():
            got = second.liveliness().get("@ros2_lv/**", timeout=60.0)
            return {str(reply.ok.key_expr) for reply in got}

        with RosNode(first, wanted):
            wait_until(lambda: tokens() == {f"@ros2_lv/0/{zid}/0/0/NN/%/%/limo", *own})

    def test_the_token_goes_with_the_publisher(self, two_sessions):
        first, second = two_sessions
        publisher = RosPublisher(first, RosTopic())

        def tokens():
            return list(second.liveliness().get("@ros2_lv/**", timeout=1.0))

        wait_until(tokens)
        publisher.close()
        wait_until(lambda: not tokens())


def attachment(sample):
    return RosAttachment.decode(sample.attachment.to_bytes())


def test_a_run_is_heard_by_a_ros_subscriber(limo, tmp_path):
    here, there = configurations_of_two(tmp_path)
    trajectory = tmp_path / "limo.traj.parquet"
    still = np.zeros((126, 7))
    position = np.tile([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0], (126, 1))
    Trajectory(np.linspace(0.0, 0.5, 126), position, still, still, robot="iiwa14").save(trajectory)
    got = []
    with open_session(config=here) as session:
        subscriber = session.declare_subscriber(KEY, got.append)
        done = limo(
            "run", "--backend", "virtual", "--trajectory", trajectory, "--rate", 100,
            "--record", tmp_path / "run.parquet", "--stream", "--ros", "--ros-domain", 3,
            "--zenoh-config", there,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        wait_until(lambda: got and attachment(got[-1]).sequence > 25)
        subscriber.undeclare()
    attachments = [attachment(sample) for sample in got]
    sequences = [about.sequence for about in attachments]
    assert sequences == sorted(set(sequences))  # best effort: a busy machine may lose some
    assert len({about.gid for about in attachments}) == 1
    assert len(decode_joint_state(got[0].payload.to_bytes()).names) == 7


def test_ros_without_a_stream_is_refused(limo, tmp_path):
    done = limo(
        "run", "--backend", "virtual", "--trajectory", tmp_path / "none", "--record",
        tmp_path / "run.parquet", "--ros",
    )  # fmt: skip
    assert done.returncode == 2
    assert "--ros publishes what --stream does; give both" in done.stderr


class TestReading:
    def read(self, names, values, torque=None):
        none = np.empty(0)
        payload = JointStateCodec(names, "base").encode(
            5, np.array(values), none, none if torque is None else np.array(torque)
        )
        attachment = RosAttachment(42, 1234, GID).encode()
        return RosReader(["a", "b"], "arm").read(payload, attachment)

    def test_sequence_and_stamp_come_from_the_attachment(self):
        found = self.read(["a", "b"], [1.0, 2.0])
        assert found.about == Attachment(42, 1234)
        assert found.source == GID.hex()

    def test_joints_are_put_in_the_order_of_the_arm_and_others_ignored(self):
        payload, _, _ = self.read(["b", "gripper", "a"], [2.0, 9.0, 1.0], [20.0, 90.0, 10.0])
        state = decode_joint_state(payload)
        assert state.names == ("a", "b")
        assert state.stamp_ns == 5
        np.testing.assert_array_equal(state.position, [1.0, 2.0])
        np.testing.assert_array_equal(state.torque, [10.0, 20.0])
        assert state.velocity.size == 0

    def test_missing_joints_are_named(self):
        with pytest.raises(WireFormatError, match=r"joint states of gripper, b, without a "):
            self.read(["gripper", "b"], [1.0, 2.0])

    def test_a_joint_named_twice_is_refused(self):
        with pytest.raises(WireFormatError, match="a joint named twice"):
            self.read(["a", "b", "a"], [1.0, 2.0, 3.0])

    @pytest.mark.parametrize("attachment", [b"", bytes(32), bytes(34), bytes(33)])
    def test_refuses_an_attachment_that_is_not_of_ros(self, attachment):
        payload = JointStateCodec(["a"]).encode(5, np.zeros(1), np.empty(0), np.empty(0))
        with pytest.raises(WireFormatError):
            RosReader(["a"], "arm").read(payload, attachment)


def state(sequence):
    values = np.array([0.1, -0.2])
    return JointState(0.001 * sequence, values, 2 * values, 3 * values, sequence)
