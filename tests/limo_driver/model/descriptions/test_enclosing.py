import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.model.descriptions.shapes import box_corners, enclosing_capsule


def distance(points, start, end):
    along = end - start
    part = (points - start) @ along / max(along @ along, 1e-300)
    return np.linalg.norm(points - start - np.clip(part, 0, 1)[:, None] * along, axis=1)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(2, 60))
def test_every_corner_is_inside(seed, many):
    random = np.random.default_rng(seed)
    points = random.normal(size=(many, 3)) * random.uniform(0.001, 1, 3) + random.normal(size=3)
    start, end, radius = enclosing_capsule(points)
    assert distance(points, start, end).max() <= radius * (1 + 1e-9) + 1e-12


def test_a_rod_gets_a_thin_capsule_along_it():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    start, end, radius = enclosing_capsule(box_corners(np.array([0.04, 0.04, 0.5])) @ turn.T)
    assert radius < 0.046
    assert np.linalg.norm(end - start) == pytest.approx(0.48, abs=0.03)


def test_a_cube_gets_a_sphere_or_nearly_one():
    start, end, radius = enclosing_capsule(box_corners(np.full(3, 0.2)))
    assert radius + np.linalg.norm(end - start) / 2 < 0.21
