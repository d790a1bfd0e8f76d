"""Arms to take the first steps with: simulated drives on a bus, a simulated controller on UDP."""

import select
import threading
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from arms import arm_config
from bus_master import DrivesBus
from controller_runs import PATIENT
from ports import free_port

from backends.can import robot as can_robot
from backends.can.config import CIA402, DAMIAO, Cia402Joint, DamiaoJoint
from backends.can.damiao import codec as damiao
from backends.can.port import BusPort
from backends.can.simulator.scenario import SWITCHED_ON, BusScenario, Guide
from backends.fri import doctor
from backends.fri.codec.messages import SessionState
from backends.fri.robot import FriRobot
from backends.fri.simulator.connection.port import Address
from backends.fri.simulator.controller import SimulatedController
from backends.fri.simulator.scenario import ControllerScenario, HandGuiding, SessionCap
from backends.fri.simulator.session import ControllerSettings
from limo_driver.app.library.first_motion.arms import CanArm, FriArm
from limo_driver.app.library.first_motion.records import Folder, Identity, description_digest
from limo_driver.app.library.first_motion.steps import FirstMotionSettings
from limo_driver.app.library.first_motion.watching import WatchSettings
from limo_driver.model import RobotModel
from limo_driver.robot.realtime import Pace
from limo_driver.robot.registry import Examination
from limopa import Exploring

START = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)  # [rad]
POSES = (  # that a hand guides the arm to
    (0.4, -0.2, 0.5, -0.6, -0.5, 0.3, 0.5),
    (-0.2, 0.3, -0.4, -1.4, 0.4, 1.2, -0.3),
)
NODES = range(11, 18)
JOINTS = {
    CIA402: tuple(
        Cia402Joint(node=node, counts_per_turn=524288, rated_torque=320.0) for node in NODES
    ),
    DAMIAO: tuple(DamiaoJoint(node=node, stiffness=500.0, damping=5.0) for node in NODES),
}
SHORT = Exploring(velocity=(0.05, 0.1), waypoints=(100, 110))


def quick(**changes):
    """Return settings for arms of tests, which are guided by a quick hand."""
    watch = WatchSettings(duration=2.6, still=0.15, most_late=1.0)  # other work may set limo aside
    settings = FirstMotionSettings(link_seconds=0.8, watch=watch, scaffolds=1, exploring=SHORT)
    return replace(settings, **changes)


class CanBench:
    """An arm on a bus whose time passes only where the driver waits.

    Args:
        faults: What goes wrong, from when the drives are switched on.
        simulation: The arm that is really there.
        guided: Whether a hand guides it to poses.
        convention: Of the drives.
    """

    def __init__(self, faults=(), simulation=None, guided=True, convention=CIA402):
        own = {} if convention == CIA402 else {"temperature": None}
        self.config = arm_config(
            convention=convention, joints=JOINTS[convention], rate=100.0, hold_after=3, **own
        )
        guides = tuple(
            Guide(at=at, lasts=0.8, position=pose)
            for at, pose in zip((1.4, 2.8), POSES, strict=True)
        )
        scenario = BusScenario(faults=(*faults, *guides * guided), origin=SWITCHED_ON)
        self.bus = DrivesBus(self.config, START, scenario, simulation)
        self.arm = CanArm(RobotModel.load("iiwa14"), ("--robot", "iiwa14"), self.config, Path("a"))
        self.settings = quick(watch=WatchSettings(duration=4.0, still=0.3))

    def plug(self, monkeypatch):
        """Let whoever opens the arm have its bus, again and again."""
        monkeypatch.setattr(self.bus, "shutdown", lambda: None)
        self.bus._is_shutdown = True
        own = self.bus
        monkeypatch.setattr(can_robot, "BusPort", lambda bus, *_: BusPort(bus, own, own.now))
        return self

    @property
    def set_points(self):
        """Frames that could have moved a drive: RPDOs, and what tells a motor of its mode more."""
        if self.config.convention == DAMIAO:
            return [
                frame for frame in self.bus.sent if frame[0] in NODES and frame[1] != damiao.DISABLE
            ]
        first, last = 0x200 + NODES[0], 0x500 + NODES[-1]
        rpdos = {base + node for base in range(0x200, 0x600, 0x100) for node in NODES}
        return [frame for frame in self.bus.sent if first <= frame[0] <= last and frame[0] in rpdos]


class Patient(Pace):
    """The pace of a controller that waits for its client, so that no test depends on a clock."""

    def __init__(self, robot, patient):
        super().__init__(1e-3 * robot.settings.period_ms)
        self._robot, self._patient = robot, patient

    def wait(self):
        robot = self._robot
        # Before the first answer nobody may be there; then every packet has one.
        commands = self._patient and robot._session.state >= SessionState.MONITORING_READY
        for _ in range(1000 if commands else 10):  # else nobody may be there
            if robot._ends < np.inf or select.select([robot._port._socket], [], [], 0.01)[0]:
                break
        return 0


class FriBench:
    """An arm behind a controller in a thread of its own, over UDP, on the robot's own clock."""

    def __init__(self, monkeypatch):
        self.port = free_port()
        monkeypatch.setattr(doctor, "PORTS", (self.port,))
        monkeypatch.setattr(doctor, "MOST_LATE", 1.0)  # of answers: other work may set limo aside
        monkeypatch.setattr(FriRobot, "now", lambda robot: robot._session.time)
        self.arm = FriArm(RobotModel.load("iiwa14"), ("--robot", "iiwa14"), "127.0.0.1", self.port)

    def pass_link(self, folder):
        """Keep the record of a first step that has passed."""
        digest = description_digest(self.arm.model)
        mine = Identity(self.arm.model.name, digest, self.arm.address)
        Folder(folder).keep("link", mine, Examination(), {})

    @contextmanager
    def controller(
        self, *events, simulation=None, monitors=True, guided=False, patient=True, **settings
    ):
        """Run a controller whose application monitors only, or asks for commands."""
        events = list(events)
        if monitors:
            ready = SessionState.MONITORING_READY
            events.append(SessionCap(at=0.0, duration=1e6, state=ready))
        if guided:
            ways = zip((0.8, 1.6), POSES, strict=True)
            events += [HandGuiding(at=at, duration=0.5, position=pose) for at, pose in ways]
        wanted = ControllerSettings(
            Address("127.0.0.1", self.port),
            position=START,
            period_ms=10,
            **{**PATIENT, **settings},
        )
        scenario = ControllerScenario(tuple(events))
        with SimulatedController(wanted, simulation, scenario) as robot:
            robot._pace = Patient(robot, patient and not monitors)
            thread = threading.Thread(target=robot.run)
            thread.start()
            try:
                yield robot
            finally:
                robot.stop()
                thread.join()
