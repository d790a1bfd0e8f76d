"""What the simulated arm picks up while it moves: the bodies of MuJoCo's model change in place."""

# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
# MuJoCo ships no stubs.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from backends.mujoco_sim.scene import compile_model

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from backends.mujoco_sim.realisation import Draft, Plant
    from limo_driver.model import RobotModel
    from limo_driver.runtime.installed_mujoco import mujoco

# All of a model that follows from its bodies' inertias.
_OF_BODIES = (
    "body_mass", "body_subtreemass", "body_inertia", "body_ipos", "body_iquat", "body_invweight0",
    "dof_M0", "dof_invweight0", "body_sameframe", "body_simple", "dof_simplenum",
)  # fmt: skip


class PickedUpLoads:
    """The loads of an arm, each from its time on.

    Args:
        draft: Which, and from when.
        model: MuJoCo's model of the arm without them, which is changed.
        robot: Rigid body without them.
        plant: Joint physics.
        period: Integration step [s].
    """

    def __init__(
        self, draft: Draft, model: mujoco.MjModel, robot: RobotModel, plant: Plant, period: float
    ) -> None:
        self._model = model
        self._starts: list[float] = []  # [s], in order
        self._bodies = [_of_bodies(model)]  # with none of the loads, one, ...
        for start, load in sorted(draft.loads, key=lambda pair: pair[0]):
            robot = load.body(robot)
            self._starts.append(start)
            self._bodies.append(_of_bodies(compile_model(robot, plant, period, draft.shafts)))
        self._carried = 0

    def __bool__(self) -> bool:
        return bool(self._starts)

    def carry(self, time: float) -> None:
        """Carry what is carried at a time [s], be it later or earlier than the last one."""
        carried = sum(start <= time for start in self._starts)
        if carried != self._carried:
            self._carried = carried
            for name, values in self._bodies[carried].items():
                getattr(self._model, name)[:] = values


def _of_bodies(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    return {name: getattr(model, name).copy() for name in _OF_BODIES}
