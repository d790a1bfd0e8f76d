import numpy as np
import pytest

from limo_driver.errors import PathError, ShapeError
from limo_driver.types import Motion

T = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6])


def test_a_parabola_is_differentiated_exactly():
    position = np.stack([1.0 + 2.0 * T + 3.0 * T**2, -(T**2)], axis=1)
    motion = Motion.from_positions(T, position)
    np.testing.assert_allclose(motion.velocity, np.stack([2.0 + 6.0 * T, -2.0 * T], 1), atol=1e-12)
    np.testing.assert_allclose(motion.acceleration, [[6.0, -2.0]] * T.size, atol=1e-10)


def test_lists_will_do():
    motion = Motion.from_positions([0, 1, 2], [[0], [1], [2]])
    np.testing.assert_array_equal(motion.velocity, [[1.0]] * 3)


@pytest.mark.parametrize(
    ("time", "position", "said"),
    [
        (T, np.zeros(6), r"expected \(T, n\) at \(6,\) times"),
        (T, np.zeros((5, 2)), r"expected \(T, n\) at \(6,\) times"),
        (T[:2], np.zeros((2, 1)), "a motion of 2 positions, expected 3 or more"),
        (T[::-1], np.zeros((6, 1)), r"0.5 s follows 0.6 s \(row 1\)"),
        ([0.0, 1.0, 1.0], np.zeros((3, 1)), r"1 s follows 1 s \(row 2\)"),
        ([0.0, np.nan, 1.0], np.zeros((3, 1)), r"nan s follows 0 s \(row 1\)"),
    ],
)
def test_what_is_no_motion_is_refused(time, position, said):
    with pytest.raises((PathError, ShapeError), match=said):
        Motion.from_positions(time, position)
