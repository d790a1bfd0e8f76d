"""The wrench at the end of an arm that explains external torques best, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.display import Displayed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.model.robot_model import RobotModel
    from limo_driver.types import FloatArray

_PRIOR: Final = 1e3  # [N, N m], standard deviation of any wrench


class Wrench(NamedTuple):
    """What the environment exerts on an arm, in the axes of a frame and about its origin."""

    value: FloatArray  # (6,) force, then torque [N, N m]
    covariance: FloatArray  # (6, 6) of its error; NaN where that of the torques is unknown


class FlangeWrench:
    """Finds wrenches from external torques, which are -Jᵀ F.

    With torques of independent errors, and a normal prior of 1 kN and 1 kN m that says what no
    joint feels: in a singular pose, or on an arm with fewer than six joints, some direction has
    that deviation.

        covariance = (J S⁻¹ Jᵀ + P⁻¹)⁻¹        F = -covariance J S⁻¹ external

    Args:
        model: Of the arm.
        frame: Link or site that moves with its last link; the flange if empty.

    Raises:
        ConfigError: The last link has no such frame.
    """

    def __init__(self, model: RobotModel, frame: str = "") -> None:
        frames = model.last_frames
        self.frame = frame or model.flange
        if self.frame not in frames:
            raise ConfigError(
                f"{model.name} has no frame {self.frame!r} that moves with its last link, expected "
                f"one of {', '.join(frames)}"
            )
        self._model = model
        place = np.linalg.solve(frames[model.flange], frames[self.frame])  # in the flange
        shift = np.cross(np.eye(3), place[:3, 3]).T  # of w, w x place
        turn = place[:3, :3].T
        self._moved = np.block([[turn, turn @ shift], [np.zeros((3, 3)), turn]])

    def jacobian(self, position: FloatArray) -> FloatArray:
        """Return the Jacobian of the frame in its own axes, (6, n), for one position (n,)."""
        axes = self._model.flange_pose(position)[:3, :3].T
        at_flange = axes @ self._model.flange_jacobian(position).reshape(2, 3, -1)
        return self._moved @ at_flange.reshape(6, -1)

    def of(self, position: FloatArray, external: FloatArray, deviation: FloatArray) -> Wrench:
        """Return the wrench on the arm.

        Args:
            position: Of the joints, (n,) [rad].
            external: Measured minus estimated torque, (n,) [N m].
            deviation: One standard deviation of it, (n,) [N m]; where one is unknown, all joints
                count alike.
        """
        J, known = self.jacobian(position), bool((deviation > 0).all())
        weighted = J / deviation**2 if known else J
        information = weighted @ J.T + np.eye(6) / _PRIOR**2
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        value = -covariance @ (weighted @ external)
        return Wrench(value, covariance * (1.0 if known else np.nan))


@dataclass(frozen=True, eq=False, repr=False)
class ExternalWrench(Displayed):
    """What the environment exerted on an arm, sample by sample.

    In the axes of a frame and about its origin: force, then torque [N, N m].
    """

    frame: str
    time: FloatArray  # (T,) [s]
    value: FloatArray  # (T, 6)
    std: FloatArray  # (T, 6), one standard deviation; NaN where errors of torque are unknown
    external: FloatArray  # (T, n) [N m], measured less estimated torque
    bias: FloatArray  # (n,) [N m], taken off that

    @property
    def force(self) -> FloatArray:
        """Size of the force, (T,) [N]."""
        return np.linalg.norm(self.value[:, :3], axis=1)

    def headline(self) -> str:
        """Say how large the force is, and how sure."""
        half, most = np.quantile(self.force, (0.5, 0.95))
        sure = np.median(1.96 * np.linalg.norm(self.std[:, :3], axis=1))
        known = "" if np.isnan(sure) else f"; 95 % of its errors within {sure:.2f} N"
        return (
            f"force at {self.frame}: half of {len(self.time)} samples below {half:.2f} N, 95 % "
            f"below {most:.2f} N{known}"
        )

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the external torque of each joint, and what was taken off it."""
        rms = np.sqrt(np.mean(self.external**2, axis=0))
        return {
            "joint": range(1, len(rms) + 1),
            "external, RMS [N m]": rms.tolist(),
            "bias [N m]": self.bias.tolist(),
        }
