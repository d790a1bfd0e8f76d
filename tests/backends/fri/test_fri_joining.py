"""A driver that joins a session which another client was commanding already."""

import numpy as np
import pytest
from fri_messages import POSE
from stepped_arm import stepped

from backends.fri.codec.messages import Generation, SessionState

pytestmark = pytest.mark.waits


@pytest.mark.parametrize("generation", [Generation.ONE, Generation.TWO_FIVE])
def test_it_starts_where_the_other_left_the_arm_and_not_where_the_application_would_be(generation):
    left = np.array(POSE) + 0.3
    with stepped(generation=generation, position=left) as robot:
        robot.arm.ipo = np.array(POSE)
        robot.receive()
        assert robot.session_state is SessionState.COMMANDING_ACTIVE
        for _ in range(3):
            robot.receive()
        assert robot.setpoint == pytest.approx(left)
        for answer in robot.arm.answers:
            assert answer.data.joint_position == pytest.approx(left)
        assert robot.arm.answers
