"""Cases are what they say: drawn from a seed alone, of the size asked for, readable by limo."""

import json

import cases
import numpy as np
import pytest
import size
import yaml
from draft import Place
from known_effects import KNOWN, LATER
from other_effects import UNKNOWN, WRONG
from world import COULOMB, FRICTION, INERTIA, World, off_within

from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording


@pytest.fixture(scope="module")
def single():
    return cases.draw(40, "single")


@pytest.mark.slow("draws a whole case twice: two motions of a minute at 1 kHz")
def test_a_seed_says_everything(single):
    again = cases.draw(40, "single")
    assert again.truth() == single.truth()
    assert again.nominal == single.nominal
    for a, b in zip(single.recordings, again.recordings, strict=True):
        np.testing.assert_array_equal(a.torque, b.torque)


@pytest.mark.slow("draws a whole case")
def test_an_answer_is_of_the_arm_that_was_written(single):
    truth = json.loads(json.dumps(single.truth()))
    assert single.is_of(truth)
    truth["effects"][0]["amplitude"] *= 1.01
    assert not single.is_of(truth)


@pytest.mark.slow("draws a whole case")
def test_the_size_is_the_one_asked_for(single):
    (hidden,) = single.hidden
    assert hidden.draft.effect == "torque_ripple"
    assert hidden.sizes.max() == pytest.approx(single.asked[0], rel=0.07)


@pytest.mark.slow("draws a whole case")
def test_limo_can_read_what_is_handed_over(single, tmp_path):
    single.write(tmp_path)
    simulation = Simulation.load(tmp_path / "sim.yaml")
    for k in (1, 2):
        recording = Recording.load(tmp_path / f"recording_{k}.parquet")
        recording.check_robot(simulation.model)
        assert sum(item.rows != () for item in recording.left_out) <= 1
    truth = json.loads((tmp_path / "hidden" / "truth.json").read_text())
    assert truth["effects"][0]["effect"] == "torque_ripple"
    given = {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert given == {"sim.yaml"} | {f"{k}_{i}.parquet" for k in ("recording", "held_out")
                                    for i in (1, 2)}  # fmt: skip


def test_nominal_values_stay_inside_their_tolerances():
    random = np.random.default_rng(3)
    world = World.draw(random)
    ratios = [off_within(world.arm, random).mass / world.arm.mass for _ in range(200)]
    assert np.std(ratios) == pytest.approx(INERTIA, rel=0.1)
    assert np.abs(np.array(ratios) - 1).max() <= 2.5 * INERTIA + 1e-12


def test_stated_friction_is_as_far_from_the_truth_as_its_tolerance_says():
    random = np.random.default_rng(4)
    world = World.draw(random)
    stated = [e for _ in range(60) for e in world.simulation_file(random)["effects"]]
    dry = np.array([e["tau_c"] for e in stated if e["effect"] == "coulomb_friction"])
    sigmas = (world.drive["coulomb"] / dry.reshape(-1, 7) - 1) / FRICTION
    assert np.std(sigmas) == pytest.approx(1.0, rel=0.1)
    assert np.abs(sigmas).max() <= 2.5 + 1e-9


@pytest.fixture(scope="module")
def bench():
    random = np.random.default_rng([5, 7001])
    plan = [(["points", "creep"], 24.0), (["fourier", "nested"], 24.0)]
    return cases._Bench(World.draw(random), random, plan)


EFFECTS = KNOWN | LATER | UNKNOWN | WRONG


@pytest.mark.slow("simulates 48 s of motion at 1 kHz for each of dozens of effects")
@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_shows(bench, name):
    make = EFFECTS[name]
    draft = make(Place(np.random.default_rng(2), 3, float(bench.floor[3]), bench.world))
    amplitude = min(10 * draft.guess, draft.largest)
    sizes = bench.sizes(draft, amplitude)
    assert sizes.max() > 0.3
    assert np.isfinite(sizes).all()


@pytest.mark.slow("plays 48 s of motion at 1 kHz")
def test_the_plain_world_has_no_size(bench):
    unchanged = size.change(bench.world, bench.respond(bench.world))
    assert bench.yardstick.sizes(unchanged, bench.world).max() < 1e-6


@pytest.mark.slow("plays 48 s of motion at 1 kHz three times")
def test_tolerances_imitate_a_scaled_friction_but_not_another_law(bench):
    stiffer = bench.world.with_drive(1, coulomb=1.1 * bench.world.drive["coulomb"][1])
    inside = bench.yardstick.sizes(size.change(stiffer, bench.respond(stiffer)), stiffer)
    assert inside.max() < 0.3
    other = bench.world.with_drive(
        1, ripple=np.array([[0.1 * COULOMB[1], 30, 0]] + 2 * [[0, 1, 0]])
    )
    outside = bench.yardstick.sizes(size.change(other, bench.respond(other)), other)
    assert outside.argmax() == 1
    assert outside[1] > 3


@pytest.mark.slow("compiles the plant, and plays 48 s of motion at 1 kHz")
@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("seed", range(6))
def test_a_wrong_value_is_stated_and_outside_its_tolerance(bench, name, seed, tmp_path):
    draft = WRONG[name](Place(np.random.default_rng(seed), 3, float(bench.floor[3]), bench.world))
    amplitude = min(draft.guess, draft.largest)
    nominal = draft.change(bench.world, amplitude).simulation_file(np.random.default_rng(seed))
    path = tmp_path / "sim.yaml"
    path.write_text(yaml.safe_dump(nominal))
    assert draft.effect in [e.name for e in Simulation.load(path).effects] + ["link_inertia"]
    described = cases.Hidden(draft, amplitude, np.ones(7)).as_dict(nominal)
    assert abs(described["wrong"]["sigmas"]) > 3
    json.dumps(described)
