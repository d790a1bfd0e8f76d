"""Motion of the simulated arm: by its own program, or by the commands of a client."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.codec.messages import JOINTS, ControlMode
from backends.fri.simulator.arm import ControlledArm
from backends.fri.simulator.client.judge import Wanted
from backends.fri.simulator.path import SetpointPath

if TYPE_CHECKING:
    from backends.fri.simulator.scenario import Now
    from backends.fri.simulator.settings import ControllerSettings
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

TRACKING: Final = 0.05  # [rad] off the set-point at which the tracking performance is 0
_MOST_STEPS: Final = 200  # [ms] that are simulated at once after a pause of the whole process


class CommandedArm:
    """The arm, its set-point, and who moves it.

    Args:
        settings: Of the controller.
        simulation: Arm and effects; the iiwa without effects if None.
    """

    def __init__(self, settings: ControllerSettings, simulation: Simulation | None) -> None:
        self._settings = settings
        start = np.array(settings.position, dtype=float)
        self.arm = ControlledArm(simulation, settings.compliance, settings.position, settings.seed)
        self.limits = self.arm.spec.limits
        self.path = SetpointPath(start, self.limits.acceleration, settings.interval_ms)
        self.state = self.arm.advance(start[None])
        self.program = np.zeros(JOINTS)  # how far the robot's own program has moved, (7,) [rad]
        self._ipo_base = start
        self.begin()

    @property
    def ipo(self) -> FloatArray:
        """Set-point of the robot's own program, (7,) [rad]."""
        return self._ipo_base + self.program

    @property
    def commanded(self) -> FloatArray:
        """Position that was commanded last, (7,) [rad]."""
        return self.path.position if self._command.position is None else self._command.position

    @property
    def commanded_torque(self) -> FloatArray:
        """Torque of the robot's model at this motion, and what the client adds, (7,) [N m]."""
        overlay = self._command.torque
        return self.state.model_torque + (0.0 if overlay is None else overlay)

    @property
    def tracking(self) -> float:
        """How closely the arm follows: 1 on the set-point, 0 at 50 mrad (limo's model)."""
        off = float(np.abs(self.path.position - self.state.position).max())
        return max(1.0 - off / TRACKING, 0.0)

    def ask(self) -> None:
        """Prepare for commands, under the control that they need; earlier ones are over."""
        self.begin()
        if self._settings.control is not ControlMode.POSITION:
            self.arm.take_control(self._settings.control, self.path.position)

    def begin(self) -> None:
        """Let the client's commands count from now on."""
        self._command = Wanted()
        self._fresh: FloatArray | None = None  # position of a command that came since

    def take(self, wanted: Wanted) -> None:
        """Follow a command; one without a position is laid over the program's own."""
        if wanted.position is None:
            wanted = wanted._replace(position=self.ipo)
        self._command, self._fresh = wanted, wanted.position

    def release(self) -> None:
        """Brake, and control the position from where the arm is."""
        self.begin()
        if self.arm.control is ControlMode.POSITION:
            self.path.rest_at(self.path.position, self.path.velocity)
        else:
            self.path.rest_at(self.state.position, self.state.velocity)
            self.arm.take_control(ControlMode.POSITION, self.state.position)

    def move(self, now: Now, time: float, steps: int, *, active: bool) -> None:
        """Move the arm for some milliseconds.

        Args:
            now: Who pushes it, and what its program does.
            time: Of the scenario [s].
            steps: Milliseconds.
            active: Whether the client's commands count.
        """
        push, self.program = np.zeros(JOINTS), np.zeros(JOINTS)
        for event in now.pushes:
            push[event.joint - 1] += event.torque
        for event in now.motions:
            phase = 2.0 * np.pi * (time - event.at) / event.duration
            self.program[event.joint - 1] += 0.5 * event.amplitude * (1.0 - np.cos(phase))
        self.arm.push(push)
        steps = min(steps, _MOST_STEPS)
        if active:
            targets, self._fresh = self.path.follow(self._fresh, steps), None
        else:
            targets = self.path.rest(self.program, steps)
            self._ipo_base = self.path.position - self.program  # also while it still brakes
        self.state = self.arm.advance(targets, self._command.torque, self._command.wrench)
