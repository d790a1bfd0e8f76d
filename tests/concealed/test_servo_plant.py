"""The concealed arm behind servos does what its numbers say."""

import arm as arm_
import numpy as np
import pytest
import servo_cases
import servo_plant as plant
from servo_plant import LINK, MOTOR, N

pytestmark = pytest.mark.slow("compiles the plant, which no change of limo touches")

RATE = 200.0
LEVEL = np.array([0.0, 0.0, 0.0, 0.0])  # stretched out


def servos(**values):
    made = servo_cases._servos(np.random.default_rng(0), 16)
    made["dry"] = made["breakaway"] = 0.0
    for name, value in values.items():
        made[name] = value
    return made


def held(made, pose=LEVEL):
    command = np.tile(pose, (600, 1))
    return plant.play(plant.hobby_arm(), made, command, 0.005, RATE).position[-1]


def weight(pose=LEVEL):
    q, still = np.array([pose]), np.zeros((1, N))
    work = arm_.Work(*(np.zeros((N, 3, 3) if k in (0, 3) else (N, 3)) for k in range(6)))
    return arm_.along(plant.hobby_arm(), work, q, still, still)[0]


def test_a_servo_sags_by_load_over_gain():
    made = servos()
    np.testing.assert_allclose(
        LEVEL - held(made), weight(held(made)) / made["gain"], rtol=0.01, atol=1e-3
    )


def test_play_shows_where_the_motor_is_looked_at():
    gap = 0.04
    seen = held(servos(gap=gap, looks_at=MOTOR, tells=LINK)) - held(servos(looks_at=MOTOR))
    told = held(servos(gap=gap, looks_at=LINK)) - held(servos(looks_at=LINK))

    assert seen[1] == pytest.approx(-gap / 2, rel=0.1)
    assert abs(told[1]) < 1e-3


def test_friction_holds_within_its_band():
    made = servos(dry=0.3)
    away = made["gain"] * (LEVEL - held(made)) - weight()
    assert np.all(np.abs(away) < 0.33)
    assert np.abs(away).max() > 0.05


def test_a_case_is_drawn_from_its_seed():
    first, again = (servo_cases.make(3, ("drive_delay",)) for _ in range(2))
    np.testing.assert_array_equal(first.recordings[0].position, again.recordings[0].position)
    (item,) = first.hidden
    assert item.effect == "drive_delay"
    assert item.joints in ((2,), (3,))
    assert servo_cases.make(3, ()).hidden == ()


def test_a_set_has_no_two_effects_at_one_joint():
    for seed in range(40):
        effects = servo_cases.drawn_set(seed)
        assert len(effects) in (2, 3)
        at = [
            item.joints
            for item in servo_cases.make(seed, effects, commanded=(0.1, np.zeros((2, 4)))).hidden
            if item.effect not in (*servo_cases.WHOLE, "swapped_joints")
        ]
        assert len(set(at)) == len(at)
