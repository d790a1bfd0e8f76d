"""What the network says of an arm, as a log of Rerun: in its viewer, in a file, or to its server.

The same values as the live page has, on the robot's own time line: the arm in 3-D, each joint's
torque as measured and as estimated with its 95 % interval, external torques, the force at the
flange that explains them best, and events.
"""

# rerun-sdk is an extra, and comes with types of its own that are not always there.
# pyright: reportMissingImports=false

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages import decode_event
from limo_driver.pages import arm_view
from limo_driver.runtime.plugins import require_package
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from limo_driver.model import RobotModel
    from limo_driver.pages.arm import ArmView
    from limo_driver.types import FloatArray

RATE: Final = 20.0  # [Hz] of the values
VIEWER: Final = "viewer"
SERVERS: Final = ("rerun://", "rerun+http://", "rerun+https://")
_LINK: Final = (170, 176, 184)
_BLUE: Final = (38, 110, 200)
_GREY: Final = (120, 120, 120)
_PALE: Final = (150, 190, 235)
_RED: Final = (210, 60, 50)
_METRES_PER_NEWTON: Final = 0.01  # of arrows
_SERIES: Final = (
    ("measured", _GREY), ("estimated", _BLUE), ("lower", _PALE), ("upper", _PALE),
)  # fmt: skip
_LEVELS: Final = {30: "WARN", 40: "ERROR", 50: "CRITICAL"}  # of events; INFO else


class RerunLog(Closing):
    """Logs an arm to Rerun until it is closed.

    Args:
        arm: Its name on the network.
        model: The robot that is drawn.
        target: `viewer` opens one on this machine, a file that ends in .rrd is written, and an
            address such as rerun+http://127.0.0.1:9876/proxy is a viewer or server elsewhere.

    Raises:
        ConfigError: The target is none of these, or its folder is not there.
        MissingPackageError: The extra limo[rerun] is not installed.
    """

    def __init__(self, arm: str, model: RobotModel, target: str) -> None:
        opened = _opener(target)
        require_package("rerun", "a view in Rerun")
        import rerun

        self._rr = rerun
        self._model, self._arm = model, arm
        self._estimated = self._drawn = -1.0  # time stamps of what was logged last [s]
        self._stream: Any = self._rr.RecordingStream(f"limo {arm}")
        opened(self._stream)
        self._stream.send_blueprint(self._blueprint())
        self._log_still(arm_view(model, np.zeros(model.n)))

    def take_event(self, sample: zenoh.Sample) -> None:
        """Log an event of the network; one that cannot be read is nothing."""
        try:
            event = decode_event(sample.payload.to_bytes())
        except WireFormatError:
            return
        self._stream.set_time("time", timestamp=event.stamp_ns / 1e9)
        level = _LEVELS.get(int(event.level), "INFO")
        self._log(["events"], self._rr.TextLog(f"{event.kind}: {event.text}", level=level))

    def take(self, shown: dict[str, Any]) -> None:
        """Log a snapshot of `ArmFeed`: what is new of it."""
        if "position" in shown and shown["stamp"] != self._drawn:
            self._drawn = shown["stamp"]
            self._stream.set_time("time", timestamp=self._drawn)
            position = np.array(shown["position"], dtype=float)
            for link, pose in enumerate(self._model.joint_poses(position)):
                at = self._rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])
                self._log(self._link(link), at)
        if "torque" in shown and shown["estimate_stamp"] != self._estimated:
            self._estimated = shown["estimate_stamp"]
            self._stream.set_time("time", timestamp=self._estimated)
            rr = self._rr
            for j, name in enumerate(self._model.joint_names):
                estimate, width = shown["torque"][j], shown["interval"][j]
                values = {"measured": shown["measured"][j], "estimated": estimate}
                if estimate is not None and width is not None:
                    values |= {"lower": estimate - width, "upper": estimate + width}
                for series, value in values.items():
                    if value is not None:
                        self._log(["torque", name, series], rr.Scalars(value))
                if shown["external"][j] is not None:
                    self._log(["external torque", name], rr.Scalars(shown["external"][j]))
            if shown["force"] is not None and None not in shown["position"]:
                flange = self._model.flange_pose(np.array(shown["position"], dtype=float))[:3, 3]
                vector = _METRES_PER_NEWTON * np.array(shown["force"], dtype=float)
                arrow = rr.Arrows3D(origins=[flange], vectors=[vector], colors=[_RED])
                self._log(["arm", "force"], arrow)

    def close(self) -> None:
        """Write what is left, and end the log."""
        if self._stream is not None:
            self._stream.flush()
            self._stream.disconnect()
            self._stream = None

    def _log(self, path: list[str], what: Any, *, static: bool = False) -> None:  # noqa: ANN401
        self._stream.log(self._path(*path), what, static=static)

    def _path(self, *names: str) -> str:
        return str(self._rr.new_entity_path([self._arm, *names]))  # names may hold slashes

    def _link(self, link: int) -> list[str]:
        return ["arm", "base" if link < 0 else self._model.link_joints[link]]

    def _log_still(self, view: ArmView) -> None:
        """Log what never changes: shapes in the frames of their joints, and how curves look."""
        rr = self._rr
        for k, mesh in enumerate(view.drawing.meshes):
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                albedo_factor=mesh.colour or _LINK,
            )
            self._log([*self._link(mesh.joint), f"mesh {k}"], shape, static=True)
        for k, capsule in enumerate(view.drawing.capsules):
            shape = rr.Capsules3D(
                lengths=[float(np.linalg.norm(capsule.end - capsule.start))],
                radii=[capsule.radius],
                translations=[capsule.start],
                quaternions=[_from_z(capsule.end - capsule.start)],
                colors=[_LINK],
                fill_mode="solid",
            )
            self._log([*self._link(capsule.joint), f"capsule {k}"], shape, static=True)
        for name in self._model.joint_names:
            for series, colour in _SERIES:
                look = rr.SeriesLines(colors=[colour], names=[series])
                self._log(["torque", name, series], look, static=True)

    def _blueprint(self) -> Any:  # noqa: ANN401  # rerun's own
        """Return what stands where: the arm and events on the left, torques on the right."""
        import rerun.blueprint as rrb

        torques = [
            rrb.TimeSeriesView(origin=self._path("torque", name), name=f"{name} [N m]")
            for name in self._model.joint_names
        ]
        return rrb.Blueprint(
            rrb.Horizontal(
                rrb.Vertical(
                    rrb.Spatial3DView(origin=self._path("arm"), name=self._arm),
                    rrb.TextLogView(origin=self._path("events"), name="events"),
                    row_shares=[3, 1],
                ),
                rrb.Tabs(
                    rrb.Grid(*torques, name="torque"),
                    rrb.TimeSeriesView(
                        origin=self._path("external torque"), name="external torque [N m]"
                    ),
                ),
            )
        )


def _opener(target: str) -> Callable[[Any], None]:
    """Return what lets a stream of Rerun go where it is told to."""
    if target == VIEWER:
        return lambda stream: stream.spawn()
    if target.startswith(SERVERS):
        return lambda stream: stream.connect_grpc(target)
    if target.endswith(".rrd"):
        if not Path(target).resolve().parent.is_dir():
            raise ConfigError(f"{target} cannot be written: its folder is not there")
        return lambda stream: stream.save(target)
    raise ConfigError(
        f"{target!r} is no place for a log of Rerun; expected {VIEWER}, a file that ends in .rrd, "
        f"or an address that begins with {', '.join(SERVERS[:-1])} or {SERVERS[-1]}"
    )


def _from_z(direction: FloatArray) -> FloatArray:
    """Return the rotation that turns z into a direction, as a quaternion xyzw (4,)."""
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        return np.array([0.0, 0.0, 0.0, 1.0])
    x, y, z = direction / length
    if z < -1.0 + 1e-9:  # half a turn, about any axis across
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([-y, x, 0.0, 1.0 + z])
    return np.asarray(quaternion / np.linalg.norm(quaternion), dtype=np.float64)
