import pytest

from limo_driver.logs.readers.columns import (
    ACCELERATION,
    COMMANDED,
    CURRENT,
    DERIVED,
    MEASURED,
    NOTHING,
    PLAIN,
    POSITION,
    TEMPERATURE,
    TIME,
    TORQUE,
    VELOCITY,
    read_name,
)

JOINTS = ("joint_a1", "joint_a2", "shoulder_pan")

KNOWN = [
    ("q0", POSITION, PLAIN, 0, ""),
    ("c1 (A)", CURRENT, PLAIN, 1, "A"),
    ("qDot1", VELOCITY, PLAIN, 1, ""),
    ("q_dot[3]", VELOCITY, PLAIN, 3, ""),
    ("qDDot1", ACCELERATION, PLAIN, 1, ""),
    ("q_dot_dot_2", ACCELERATION, PLAIN, 2, ""),
    ("force", TORQUE, PLAIN, None, ""),
    ("F1 (N)", TORQUE, PLAIN, 1, "N"),
    ("tau1 (N·m)", TORQUE, PLAIN, 1, "N m"),
    ("tau1 [N*m]", TORQUE, PLAIN, 1, "N m"),
    ("tau1 [Nmm]", TORQUE, PLAIN, 1, "N mm"),
    ("tau1 [cNm]", TORQUE, PLAIN, 1, "N cm"),
    ("F1 (kN)", TORQUE, PLAIN, 1, "kN"),
    ("tau1_ff", TORQUE, COMMANDED, 1, ""),
    ("tick_ms", TIME, PLAIN, None, "ms"),
    ("sec", TIME, PLAIN, None, "s"),
    ("ms", TIME, PLAIN, None, "ms"),
    ("s", NOTHING, PLAIN, None, ""),
    ("nm", NOTHING, PLAIN, None, ""),
    ("position_1", POSITION, PLAIN, 1, ""),
    ("actual_q_0", POSITION, MEASURED, 0, ""),
    ("actual_qd_5", VELOCITY, MEASURED, 5, ""),
    ("target_q_3", POSITION, COMMANDED, 3, ""),
    ("actual_current_2", CURRENT, MEASURED, 2, ""),
    ("actual_TCP_speed_0", NOTHING, MEASURED, 0, ""),
    ("TorqueCur3", TORQUE, PLAIN, 3, ""),
    ("actual_current_as_torque_3", TORQUE, MEASURED, 3, ""),
    ("PositionCmptd3", POSITION, DERIVED, 3, ""),
    ("q[3]", POSITION, PLAIN, 3, ""),
    ("q_d[3]", POSITION, COMMANDED, 3, ""),
    ("tau_J[6]", TORQUE, PLAIN, 6, ""),
    ("tau_ext_hat_filtered[2]", TORQUE, DERIVED, 2, ""),
    ("axisQMsr_LBR_iiwa_14_R820_1", POSITION, MEASURED, 1, ""),
    ("axisTauMsr_LBR_iiwa_14_R820_7", TORQUE, MEASURED, 7, ""),
    ("joint1_pos_deg", POSITION, PLAIN, 1, "deg"),
    ("A3 [deg]", POSITION, PLAIN, 3, "deg"),
    ("A3 [°/s]", VELOCITY, PLAIN, 3, "deg/s"),
    ("J3 Torque (Nm)", TORQUE, PLAIN, 3, "N m"),
    ("vel_1_deg_s", VELOCITY, PLAIN, 1, "deg/s"),
    ("motor_4_temperature", TEMPERATURE, PLAIN, 4, ""),
    ("observation.state.shoulder_pan.pos", POSITION, MEASURED, "shoulder_pan", ""),
    ("observation.state.shoulder_pan", POSITION, MEASURED, "shoulder_pan", ""),
    ("action.shoulder_pan", POSITION, COMMANDED, "shoulder_pan", ""),
    ("state_3", NOTHING, PLAIN, 3, ""),
    ("effort.joint_a2", TORQUE, PLAIN, "joint_a2", ""),
    ("joint_a2_eff", TORQUE, PLAIN, "joint_a2", ""),
    ("joint_a1", NOTHING, PLAIN, "joint_a1", ""),
    ("joint_a1_Nm", TORQUE, PLAIN, "joint_a1", "N m"),
    ("shoulder_pan_deg", POSITION, PLAIN, "shoulder_pan", "deg"),
    ("shoulder_pan_A", NOTHING, PLAIN, "shoulder_pan", ""),
    ("A3", NOTHING, PLAIN, 3, ""),
    ("pos_A3", POSITION, PLAIN, 3, ""),
    ("velA3", VELOCITY, PLAIN, 3, ""),
    ("tau_A3", TORQUE, PLAIN, 3, ""),
    ("tauA3", TORQUE, PLAIN, 3, ""),
    ("tau_a_3", TORQUE, PLAIN, 3, ""),
    ("effort.A3", TORQUE, PLAIN, 3, ""),
    ("tau_A3_A", TORQUE, PLAIN, 3, "A"),
    ("tau_3 (A)", TORQUE, PLAIN, 3, "A"),
    ("tau_A[3]", TORQUE, PLAIN, 3, "A"),
    ("current_A3", CURRENT, PLAIN, 3, ""),
    ("current_3_A", CURRENT, PLAIN, 3, "A"),
    ("current_mA_3", CURRENT, PLAIN, 3, "mA"),
    ("current_ma3", CURRENT, PLAIN, 3, "mA"),
    ("pos_3_A", POSITION, PLAIN, 3, ""),
    ("t_ms", TIME, PLAIN, None, "ms"),
    ("ZeitinNanoSec", TIME, PLAIN, None, "ns"),
    ("gripper_pos", POSITION, PLAIN, None, ""),
    ("comment", NOTHING, PLAIN, None, ""),
]


@pytest.mark.parametrize(("column", "quantity", "rank", "joint", "unit"), KNOWN)
def test_a_name_says_what_it_is_of(column, quantity, rank, joint, unit):
    name = read_name(column, JOINTS)
    found = (name.quantity, name.rank, name.joint, name.unit)
    assert found == (quantity, rank, joint, unit)


def test_the_longest_joint_is_meant():
    assert read_name("wrist_roll_2_pos", ("wrist", "wrist_roll_2")).joint == "wrist_roll_2"


def test_columns_of_one_quantity_are_one_family():
    kinds = {read_name(f"axisQMsr_LBR_iiwa_14_R820_{j}").kind for j in range(1, 8)}
    assert len(kinds) == 1
