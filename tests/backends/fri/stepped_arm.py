"""An ideal arm behind FRI that moves one cycle when it is told to, over real UDP.

Time is the arm's own and stands still between cycles, so that no test depends on the speed of the
machine: `SteppedRobot` lets its arm take one cycle before every `receive`.
"""

import socket
import threading
from dataclasses import dataclass, field

import numpy as np
from fri_messages import POSE, monitoring
from ports import free_port

from backends.fri.codec import messages as m
from backends.fri.codec.codec import decode_command, encode_monitoring
from backends.fri.codec.messages import Generation
from backends.fri.connection import _KERNEL_TIME
from backends.fri.robot import FriRobot

HOST = "127.0.0.2"  # the arm's; the driver listens on all addresses
INERTIA = 2.0  # [kg m^2] of every joint


@dataclass
class SteppedArm:
    """Sends a packet when told; obeys what was answered."""

    port: int = field(default_factory=free_port)
    generation: Generation = Generation.ONE
    mode: m.CommandMode = m.CommandMode.POSITION
    position: np.ndarray = field(default_factory=lambda: np.array(POSE))
    period_ms: int = 1
    multiplier: int = 1
    state: m.SessionState = m.SessionState.COMMANDING_ACTIVE
    quality: m.Quality = m.Quality.EXCELLENT
    host: str = HOST
    first_sequence: int = 0

    def __post_init__(self):
        self.position = np.array(self.position, dtype=float)
        self.ipo = self.position.copy()
        self.velocity = np.zeros(7)
        self.torque = np.zeros(7)
        self.sequence, self.reflected, self.ns = self.first_sequence, 0, 10**18
        self.answers = []  # every command ever received
        self.losing = 0  # packets that the network loses
        self.deaf = 0  # answers that the network loses
        self.io = ()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((self.host, 0))
        self.socket.settimeout(60.0)

    def message(self, **changes):
        message = monitoring(self.generation, self.sequence, self.state)
        data = message.data._replace(
            measured_position=tuple(self.position),
            measured_torque=tuple(self.torque),
            timestamp=m.Timestamp(*divmod(self.ns, 10**9)),
            io=self.io,
        )
        if self.generation is Generation.ONE:
            data = data._replace(commanded_position=tuple(self.position))
        message = message._replace(
            header=m.Header(self.sequence, self.reflected),
            data=data,
            connection=m.ConnectionInfo(self.state, self.quality, self.period_ms, self.multiplier),
            ipo=m.IpoData(tuple(self.ipo), command_mode=self.mode),
        )
        return message._replace(**changes)

    def send(self, message=None):
        message = self.message() if message is None else message
        self.throw(encode_monitoring(message, self.generation))

    def throw(self, data):
        self.socket.sendto(data, ("127.0.0.1", self.port))

    def listen(self):
        """Take what was answered, without waiting."""
        self.socket.settimeout(0)
        taken = []
        try:
            while True:
                taken.append(decode_command(self.socket.recv(2000), self.generation))
        except BlockingIOError:
            pass
        for command in taken:
            if self.deaf:
                self.deaf -= 1
                continue
            self.answers.append(command)
            self.reflected = command.header.sequence
        return taken

    def obey(self):
        """Move for one cycle as the last answer says."""
        h = 1e-3 * self.period_ms
        if self.state is not m.SessionState.COMMANDING_ACTIVE or not self.answers:
            return
        data = self.answers[-1].data
        if self.mode is m.CommandMode.POSITION and data is not None:
            self.velocity = (np.array(data.joint_position) - self.position) / h
            self.position = np.array(data.joint_position)
        elif self.mode is m.CommandMode.TORQUE and data is not None and data.joint_torque:
            self.velocity = self.velocity + h * np.array(data.joint_torque) / INERTIA
            self.position = self.position + h * self.velocity

    def cycle(self):
        """Take answers, move, and send the next packet unless the network loses it."""
        self.listen()
        self.obey()
        self.sequence = (self.sequence + 1) % 2**32
        self.ns += self.period_ms * 1_000_000
        if self.losing:
            self.losing -= 1
        else:
            self.send()

    def close(self):
        self.socket.close()


def wake(arm, **options):
    """Open a robot while the arm keeps sending its first packet; nothing is left in the queue."""
    done = threading.Event()

    def call():
        while not done.wait(2e-3):
            arm.send()

    caller = threading.Thread(target=call)
    caller.start()
    try:
        robot = options.pop("factory", FriRobot)(arm.host, arm.port, "iiwa14", **options)
    finally:
        done.set()
        caller.join()
    while robot._link.endpoint.receive(0.0) is not None:
        pass
    return robot


class SteppedRobot(FriRobot):
    """The driver with an arm that takes one cycle before every `receive`."""

    arm = None

    def _receive(self, timeout):
        if self.arm is None:
            return super()._receive(timeout)
        if not self._replied:
            self._reply(None)
        for _ in range(self.arm.multiplier):
            self.arm.cycle()
        return super()._receive(0.0 if self.arm.losing or timeout is None else timeout)

    def lose_measurements(self, count):
        self.arm.losing = count

    def _close(self):
        super()._close()
        if self.arm is not None:
            self.arm.close()


def keep_kernel_time(robot, *, on):
    """Let the kernel say how long packets wait: in this machine's time, which is not the arm's."""
    robot._link.endpoint._socket.setsockopt(socket.SOL_SOCKET, _KERNEL_TIME, int(on))


def stepped(**options):
    arm_options = {
        name: options.pop(name) for name in tuple(options) if name in SteppedArm.__annotations__
    }
    arm = SteppedArm(**arm_options)
    try:
        robot = wake(arm, factory=SteppedRobot, **options)
    except BaseException:
        arm.close()
        raise
    robot.arm = arm
    keep_kernel_time(robot, on=False)
    arm.sequence = arm.first_sequence - 1  # the first cycle's packet is the first of the session
    arm.ns -= arm.period_ms * 1_000_000
    return robot
