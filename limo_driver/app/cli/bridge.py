"""`limo bridge`: what a service says of an arm, as topics of ROS 2."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Annotated

import typer

from limo_driver.app.console.command_line import (
    RobotOption,
    RosDomain,
    SessionOptions,
    describe_options,
)
from limo_driver.app.console.terminal import say


@describe_options
def command(
    *,
    arm: str,
    robot: RobotOption = "iiwa14",
    frame: Annotated[str, typer.Option("--wrench-frame", metavar="LINK")] = "",
    namespace: str | None = None,
    ros_domain: RosDomain = 0,
    states: Annotated[str | None, typer.Option("--ros", metavar="TOPIC")] = None,
    network: SessionOptions,
    duration: Annotated[float | None, typer.Option(min=0.0)] = None,
) -> None:
    """Publish estimated and external torque, and the wrench on the flange, for ROS 2 (rmw_zenoh).

    The topics torque, torque_std and external_torque are sensor_msgs/JointState with effort;
    wrench and wrench_std are geometry_msgs/WrenchStamped, wrench_covariance is a
    std_msgs/Float64MultiArray of 6 by 6; events are rcl_interfaces/Log, which is kept for
    subscribers that come late. Stamps are those of the joint states. docs/ros2.md says more.

    Args:
        arm: Name of the arm, as `limo serve` has it.
        frame: Link or site fixed to the last link, in which the wrench is; else the flange.
        namespace: Of the topics; /limo/NAME if not given, / for none.
        states: Topic of ROS 2 with the joint states, where `limo serve` takes them from it.
        duration: Stop after this time [s]; else at Ctrl-C.

    Examples:
        limo bridge --arm iiwa14 --connect tcp/127.0.0.1:7447
        limo bridge --arm left --robot arm.urdf --wrench-frame tool0
    """
    from limo_driver.app.live.ros_bridge import RosBridge, topics
    from limo_driver.model import RobotModel
    from limo_driver.network.config import require_passage
    from limo_driver.network.ros import RosTopic
    from limo_driver.network.streaming import Keys

    keys, model, warn = Keys(arm), RobotModel.load(robot), partial(say, stderr=True)
    published = topics(keys.root if namespace is None else namespace, ros_domain)
    source = None if states is None else RosTopic(states, ros_domain)
    if network.config is not None:
        require_passage(network.config, published[0].key, "egress", "the bridge")
    warn = partial(say, stderr=True)
    with (
        network.open() as session,
        RosBridge(session, keys, model, published, frame, source, warn) as bridge,
    ):
        say(f"/{published[0].name} ... /{published[-1].name}, wrench in {bridge.wrench.frame}")
        with suppress(KeyboardInterrupt):
            bridge.ended.wait(duration)
    if bridge.error is not None:
        raise bridge.error
    counts = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in bridge.counts.items())
    say(counts)
