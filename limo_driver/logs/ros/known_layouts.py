"""Layouts of messages whose definition a bag lacks: `.db3` before ROS 2 Iron has none.

A type may have changed from one distribution to the next, and a bag does not say which it is of.
The layout is the one that takes every byte of a message, no more and no fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from limo_driver.errors import WireFormatError
from limo_driver.logs.ros.message_layout import DecodedMessage, MessageLayout, layout_of

_STATE: Final = "control_msgs/msg/JointTrajectoryControllerState"
_HEAD: Final = "std_msgs/Header header\n"
_PARTS: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation",
    "geometry_msgs/Twist": "Vector3 linear\nVector3 angular",
    "trajectory_msgs/JointTrajectoryPoint": "float64[] positions\nfloat64[] velocities\n"
    "float64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start",
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": "geometry_msgs/Transform[] transforms\n"
    "geometry_msgs/Twist[] velocities\ngeometry_msgs/Twist[] accelerations\n"
    "builtin_interfaces/Duration time_from_start",
    "iiwa_msgs/JointQuantity": "\n".join(f"float32 a{j}" for j in range(1, 8)),
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "Point position\nQuaternion orientation",
    "geometry_msgs/Wrench": "Vector3 force\nVector3 torque",
    "geometry_msgs/Accel": "Vector3 linear\nVector3 angular",
    "geometry_msgs/Inertia": "float64 m\nVector3 com\n"
    + "".join(f"float64 {name}\n" for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    **{
        f"geometry_msgs/{name}Stamped": f"std_msgs/Header header\n{name} {name.lower()}"
        for name in ("Pose", "Wrench", "Twist", "Accel", "Inertia")
    },
    "sensor_msgs/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort",
    "franka_msgs/Elbow": "".join(
        f"float64[2] {name}\n"
        for name in (
            "position",
            "desired_position",
            "commanded_position",
            "commanded_velocity",
            "commanded_acceleration",
        )
    ),
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset",
}
_FORMER: Final = ("desired", "actual", "error")
_NEWER: Final = ("reference", "feedback", "error", "output")


def _state(points: Sequence[str], *, with_bodies: bool) -> str:
    """Return the definition of a state of a trajectory controller."""
    text = f"{_HEAD}string[] joint_names\n"
    text += "".join(f"trajectory_msgs/JointTrajectoryPoint {name}\n" for name in points)
    if with_bodies:
        kind = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
        text += "string[] multi_dof_joint_names\n"
        text += "".join(f"{kind} multi_dof_{name}\n" for name in points)
    return text


# Of a Franka arm: numbers of each field, in order. The ends are flags, of which libfranka's
# versions have more and more; between them nothing is moved.
_FRANKA: Final = (
    "cartesian_collision 6, cartesian_contact 6, q 7, q_d 7, dq 7, dq_d 7, ddq_d 7, theta 7, "
    "dtheta 7, tau_j 7, dtau_j 7, tau_j_d 7, k_f_ext_hat_k 6, elbow 2, elbow_d 2, elbow_c 2, "
    "delbow_c 2, ddelbow_c 2, joint_collision 7, joint_contact 7, o_f_ext_hat_k 6, o_dp_ee_d 6, "
    "{acceleration}o_dp_ee_c 6, o_ddp_ee_c 6, tau_ext_hat_filtered 7, m_ee 1, f_x_cee 3, i_ee 9, "
    "m_load 1, f_x_cload 3, i_load 9, m_total 1, f_x_ctotal 3, i_total 9, o_t_ee 16, o_t_ee_d 16, "
    "o_t_ee_c 16, f_t_ee 16, {nominal}ee_t_k 16, time 1, control_command_success_rate 1"
)
_ERRORS: Final = (36, 37, 38, 41)  # flags of errors
_MODE: Final = "uint8 robot_mode\n"


def _numbers(text: str) -> str:
    """Return the definition of arrays of fixed length, as `q 7` says it of each."""
    pairs = (item.split() for item in text.split(", "))
    return "".join(f"float64[{many}] {name}\n" for name, many in pairs)


def _flags(many: int) -> str:
    return f"{_MODE}bool[{many}] current_errors\nbool[{many}] last_motion_errors\n"


def _franka(*, with_nominal_frame: bool) -> str:
    """Return the definition of the state of an arm, all but its flags."""
    more = ("o_ddp_o 3, ", "f_t_ne 16, ne_t_ee 16, ") if with_nominal_frame else ("", "")
    return _HEAD + _numbers(_FRANKA.format(acceleration=more[0], nominal=more[1]))


def _franka_robot() -> str:
    """Return the definition of the newer state of an arm, all but its flags."""
    stamped = {
        "Wrench": "k_f_ext_hat_k o_f_ext_hat_k",
        "Inertia": "inertia_ee inertia_load inertia_total",
        "Pose": "o_t_ee o_t_ee_d o_t_ee_c f_t_ee ee_t_k",
        "Twist": "o_dp_ee_d o_dp_ee_c",
        "Accel": "o_ddp_ee_c",
    }
    states = "measured_joint_state desired_joint_state measured_joint_motor_state"
    text = _HEAD + _numbers("collision_indicators 26")
    text += "".join(f"sensor_msgs/JointState {name}\n" for name in states.split())
    text += _numbers("ddq_d 7, dtau_j 7") + "sensor_msgs/JointState tau_ext_hat_filtered\n"
    text += "Elbow elbow\n"
    for kind, names in stamped.items():
        text += "".join(f"geometry_msgs/{kind}Stamped {name}\n" for name in names.split())
    return text + _numbers("time 1, control_command_success_rate 1")


_KNOWN: Final = {
    "franka_msgs/msg/FrankaState": tuple(
        _franka(with_nominal_frame=nominal) + _flags(many)
        for nominal in (False, True)
        for many in _ERRORS
    ),
    "franka_msgs/msg/FrankaRobotState": tuple(_franka_robot() + _flags(n) for n in _ERRORS),
    _STATE: (
        _state((*_NEWER, "desired", "actual"), with_bodies=True),  # Humble, since 4.4
        _state(_NEWER, with_bodies=True),
        _state(_FORMER, with_bodies=True),  # Humble, before
        _state(_FORMER, with_bodies=False),  # Foxy, Galactic
    ),
    "std_msgs/msg/Float64MultiArray": ("MultiArrayLayout layout\nfloat64[] data",),
} | {
    f"iiwa_msgs/msg/Joint{name}": (f"{_HEAD}JointQuantity {name.lower()}",)
    for name in ("Position", "Torque", "Velocity")
}


class KnownLayout:
    """Reads messages of a type by whichever of its layouts takes all of a message.

    Args:
        layouts: Of the distributions of ROS 2.
    """

    def __init__(self, layouts: Sequence[MessageLayout]) -> None:
        self._layouts = list(layouts)

    def decode(self, payload: bytes | memoryview) -> DecodedMessage:
        """Return the numbers of one message.

        Raises:
            WireFormatError: No layout takes all of it.
        """
        error = WireFormatError("of no known layout", 0)
        for layout in self._layouts:
            try:
                decoded = layout.decode(payload)
            except WireFormatError as found:
                error = found
                continue
            if layout is not self._layouts[0]:  # most likely that of the next one, too
                self._layouts.remove(layout)
                self._layouts.insert(0, layout)
            return decoded
        raise error


@lru_cache(maxsize=64)
def layout_for(name: str, definition: bytes) -> MessageLayout | KnownLayout | str:
    """Return the layout of a type, as the bag defines it or as it is known, or why there is none.

    Args:
        name: Of the type.
        definition: As the bag has it; empty where it has none.
    """
    if definition or name not in _KNOWN:
        return layout_of(name, definition)
    parts = "".join(f"{'=' * 80}\nMSG: {kind}\n{text}\n" for kind, text in _PARTS.items())
    return KnownLayout([MessageLayout(name, f"{text}\n{parts}") for text in _KNOWN[name]])
