"""Topics of ROS 2 as a peer of others hears them: zenoh-ros2-sdk, in a process of its own."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from ports import free_port
from sessions import configurations_of_two, wait_until

from limo_driver.app.live.ros_bridge import EVENTS, STREAMS, RosBridge, topics
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.kinematics import FlangeWrench
from limo_driver.network.ros import HASHES, RosReader, RosTopic
from limo_driver.network.streaming import Keys, open_session

pytestmark = pytest.mark.waits
FOREIGN = pytest.mark.skipif(
    importlib.util.find_spec("zenoh_ros2_sdk") is None, reason="needs zenoh-ros2-sdk"
)
BENCHMARK = Path(__file__).parents[4] / "benchmarks" / "service" / "ros_topics.py"


@pytest.fixture(scope="module")
def peers():
    """The benchmark, which has the peer and what plays the service."""
    spec = importlib.util.spec_from_file_location("ros_topics", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def arm():
    return RobotModel.load("iiwa14")


@pytest.fixture
def network(tmp_path):
    """A session at a port of this machine, which the peer is given."""
    here, _ = configurations_of_two(tmp_path)
    port = int(here.read_text().split("127.0.0.1:")[1].split('"')[0])
    with open_session(config=here) as session:
        yield session, port


@FOREIGN
@pytest.mark.slow("another program starts")
def test_a_foreign_peer_hears_everything_and_is_heard(network, peers, arm, tmp_path):
    session, port = network
    warned, states = [], []
    wanted = [*(f"{name}:{kind}" for name, kind in STREAMS.items()), f"{EVENTS}:{peers.LOG}"]
    with RosBridge(session, Keys("iiwa14"), arm, topics("/", 0), tell=warned.append) as bridge:
        source = peers.Source(session)
        for number in range(peers.EVENTS):
            source.tell(number)
        with peers.foreign_peer(port, tmp_path, [*wanted, "+joint_states"]) as ask:
            wait_until(lambda: ask("heard")[peers.ALL]["count"] == peers.EVENTS)  # came late
            assert ask("heard")[EVENTS]["count"] == 1  # as that peer asks for history

            def everything():
                source.publish()
                return all(ask("heard")[name]["count"] for name in STREAMS)

            wait_until(everything)
            heard = {name: each.get("last") for name, each in ask("heard").items()}
            topic = RosTopic("joint_states").key_of_any_hash
            subscriber = session.declare_subscriber(topic, states.append)
            ask("publish 100 0.2")
            wait_until(lambda: len(states) > 10)
            subscriber.undeclare()
    assert not warned
    assert bridge.counts["malformed"] == 0
    for name, values in zip(
        STREAMS, (10.0 * source.external, source.std, source.external), strict=False
    ):
        assert heard[name]["effort"] == values.tolist()
        assert heard[name]["name"] == list(arm.joint_names)
        assert heard[name]["position"] == []
    wrench = FlangeWrench(arm).of(source.pose, source.external, source.std)
    deviation = np.sqrt(np.diag(wrench.covariance))
    for name, values in (("wrench", wrench.value), ("wrench_std", deviation)):
        assert heard[name]["header"]["frame_id"] == "flange"
        found = heard[name]["wrench"]
        got = [found[part][axis] for part in ("force", "torque") for axis in "xyz"]
        np.testing.assert_allclose(got, values, rtol=1e-12)
    matrix = heard["wrench_covariance"]
    np.testing.assert_allclose(matrix["data"], wrench.covariance.ravel(), rtol=1e-12)
    assert [d["label"] for d in matrix["layout"]["dim"]] == ["flange", "flange"]
    read = RosReader(arm.joint_names, "iiwa14").read(
        states[0].payload.to_bytes(), states[0].attachment.to_bytes()
    )
    assert read.about.sequence >= 0


@FOREIGN
@pytest.mark.slow("another program starts")
def test_a_peer_with_another_type_hash_is_told_of(network, peers, arm, tmp_path):
    session, port = network
    warned = []
    kind = STREAMS["wrench"]
    with (
        RosBridge(session, Keys("iiwa14"), arm, topics("/", 0), tell=warned.append),
        peers.foreign_peer(port, tmp_path, [f"wrench:{kind}:RIHS01_{'0' * 64}"]),
    ):
        wait_until(lambda: warned)
    (line,) = warned
    assert "hears nothing of wrench" in line
    assert f"RIHS01_{'0' * 64}, and gets" in line
    assert line.endswith(HASHES[kind])


class TestOneLineSays:
    def bridged(self, limo, *options):
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        return limo("bridge", "--arm", "a", "--listen", endpoint, *options)

    def test_that_the_frame_does_not_exist(self, limo):
        done = self.bridged(limo, "--wrench-frame", "tool0")
        assert done.returncode == 2
        assert done.stderr == (
            "limo: iiwa14 has no frame 'tool0' that moves with its last link, expected one of "
            "link7, flange\n"
        )

    def test_that_ros_has_no_such_namespace(self, limo):
        done = self.bridged(limo, "--namespace", "a-b")
        assert done.returncode == 2
        assert "the ROS topic is 'a-b/torque'" in done.stderr

    def test_that_the_model_is_of_another_robot(self, peers, network, two_links_urdf):
        session, _ = network
        model = RobotModel.load(two_links_urdf)
        with RosBridge(session, Keys("iiwa14"), model, topics("/", 0)) as bridge:
            source = peers.Source(session)
            wait_until(lambda: source.publish() or bridge.ended.is_set())
        assert isinstance(bridge.error, ConfigError)
        assert "estimates are of joints joint1, joint2" in str(bridge.error)
        assert "are a, b: name the arm's robot with `robot`" in str(bridge.error)


def test_poses_are_taken_between_states(network, arm):
    session, _ = network
    with RosBridge(session, Keys("iiwa14"), arm, topics("/", 0)) as bridge:
        poses = [(stamp, np.full(7, value)) for stamp, value in ((0, 0.0), (10, 1.0), (20, 5.0))]
        bridge._poses.extend(poses)
        for stamp, expected in ((0, 0.0), (5, 0.5), (10, 1.0), (15, 3.0), (20, 5.0)):
            np.testing.assert_allclose(bridge._position(stamp), expected)
        assert bridge._position(21) is None
        assert bridge._position(19) is None  # let go
