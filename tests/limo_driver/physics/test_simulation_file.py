"""Mistakes in a sim.yaml are named with their line and what exists."""

import numpy as np
import pytest

from limo_driver.errors import ConfigError
from limo_driver.physics import CATALOGUE, Simulation
from limo_driver.types import Motion

SPECIFIED = """\
robot: iiwa14
inertials: {link4: {mass: 3.4, com: [0, 0.067, 0.034], inertia: [0.017, 0, 0, 0.0164, 0, 0.006]}}
tolerances: {inertia: 0.02, friction: 0.15}
sensors: {torque_noise: [0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02], encoder_resolution: 1e-5}
effects:
  - {effect: coulomb_friction, joint: 1, tau_c: 2.2, v_eps: 0.002}
  - {effect: viscous_friction, joint: 1, f_v: 4.0}
"""


def effect(text: str) -> str:
    return "robot: iiwa14\neffects:\n  - {" + text + "}"


@pytest.fixture
def load(tmp_path):
    def write_and_load(text: str) -> Simulation:
        path = tmp_path / "sim.yaml"
        path.write_text(text)
        return Simulation.load(path)

    return write_and_load


def test_the_specified_form_is_read(load):
    simulation = load(SPECIFIED)
    assert simulation.model.inertials["link4"].mass == 3.4
    assert simulation.effects[0].tau_c == 2.2
    assert simulation.sensors.encoder_resolution == (1e-5,)  # YAML alone reads 1e-5 as text


def test_tolerances_that_nobody_stated_are_written_and_read_as_guessed(load, tmp_path):
    partly = load("robot: iiwa14\ntolerances: {friction: 0.15}\n")
    assert partly.tolerances.assumed == {"inertia", "drive", "gain"}  # 0.15 is usual, and stated
    partly.save(tmp_path / "again.yaml")
    assert "guessed: [inertia]" in (tmp_path / "again.yaml").read_text()
    again = Simulation.load(tmp_path / "again.yaml").tolerances
    assert again == partly.tolerances
    assert again.assumed == partly.tolerances.assumed
    assert again.with_stated(inertia=0.02).assumed == {"drive", "gain"}


@pytest.mark.parametrize(
    ("given", "refused"),
    [
        ("guessed: [mass]", r"line 2: tolerances: guessed: number 1 is 'mass', expected one of"),
        ("stated: [inertia]", r"line 2: tolerances: has no 'stated'; it has inertia, friction"),
    ],
)
def test_only_tolerances_are_guessed(load, given, refused):
    with pytest.raises(ConfigError, match=refused):
        load(f"robot: iiwa14\ntolerances: {{{given}}}\n")


def test_inertials_override_only_what_they_give(load):
    simulation = load("robot: iiwa14\ninertials: {link4: {mass: 3.4}}\n")
    assert simulation.model.inertials["link4"].com == pytest.approx((0, 0.067, 0.034))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "is empty"),
        ("- 1", 1, "is a list, expected a mapping"),
        ("effects: []", 1, "lacks `robot:`"),
        ("robot: iiwa15", 1, "'iiwa15' is neither built in"),
        ("robot: [", 1, "is no YAML"),
        ("robot: iiwa14\x00", None, "is no YAML"),
        ("robot: " + "[" * 1500, None, "is no YAML"),
        ("robot: [iiwa14]", 1, "robot is a list, expected a text"),
        (effect("effect: [viscous_friction], joint: 1"), 3, "effect is a list, expected a text"),
        (
            effect("effect: viscous_friction, joint: [1], f_v: 1"),
            3,
            "joint is a list, expected a whole number",
        ),
        ("robot: iiwa14\neffects:\n  - {[1]: 2}", 3, "has a list as a name, expected a text"),
        ("robot: iiwa14\nefects: []", 2, "has no 'efects'; it has robot, inertials"),
        ("robot: iiwa14\nrobot: iiwa14", 2, "'robot' twice"),
        ("robot: iiwa14\neffects: 3", 2, "effects is '3', expected a list of mappings"),
        ("robot: iiwa14\neffects:\n  - 3", 3, "is '3', expected a mapping"),
        (effect("joint: 1"), 3, "lacks `effect:`"),
        (
            "robot: iiwa14\neffects:\n  - {effect: stiction, joint: 1}",
            3,
            "effect is 'stiction', expected one of",
        ),
        (
            "robot: iiwa14\neffects:\n  - {effect: viscous_friction, joint: 1, f_v: 1}\n"
            "  - {effect: viscous_friction, joint: 8, f_v: 1}",
            4,
            "viscous_friction: joint is 8, expected a joint from 1 to 7",
        ),
        (
            "robot: iiwa14\neffects:\n  - {effect: viscous_friction, joint: 1.5, f_v: 1}",
            3,
            "joint is '1.5', expected a joint from 1 to 7",
        ),
        (effect("effect: viscous_friction, joint: 1"), 3, "lacks f_v"),
        (effect("effect: viscous_friction, f_v: 1"), 3, "lacks joint"),
        (
            "robot: iiwa14\neffects:\n  - {effect: coulomb_friction, joint: 1, tau: 1}",
            3,
            "has no 'tau'; it has effect, joint, tau_c, v_eps",
        ),
        (
            "robot: iiwa14\neffects:\n  - {effect: viscous_friction, joint: 1, f_v: -1}",
            3,
            "f_v is -1 N m s/rad, expected a number from 0 to 10000000 N m s/rad",
        ),
        (
            "robot: iiwa14\neffects:\n  - {effect: viscous_friction, joint: 1, f_v: x}",
            3,
            "f_v is 'x', expected a number",
        ),
        (
            effect("effect: viscous_friction, joint: 1, f_v: .inf"),
            3,
            "f_v is '.inf', expected a number",
        ),
        ("robot: iiwa14\ninertials: {link9: {mass: 1}}", 2, "has no 'link9'; it has link1"),
        (
            "robot: iiwa14\ninertials: {link1: {com: [0, 0]}}",
            2,
            "com is [0, 0], expected a list of 3 numbers",
        ),
        ("robot: iiwa14\ninertials: {link1: {mass: -1}}", 2, "no rigid body"),
        (
            "robot: iiwa14\ninertials: {link1: {inertia: [1, 0, 0, 0.1, 0, 0.1]}}",
            2,
            "no rigid body",
        ),
        (
            "robot: iiwa14\ntolerances: {inertia: -1}",
            2,
            "inertia is -1, expected a number of 0 or more",
        ),
        (
            "robot: iiwa14\nsensors: {torque_noise: [1, 2]}",
            2,
            "expected one number for all 7 joints, or one each",
        ),
        ("robot: iiwa14\nsensors: {noise: 1}", 2, "has no 'noise'"),
    ],
)
def test_a_mistake_is_named_with_its_line(load, text, line, message):
    with pytest.raises(ConfigError) as caught:
        load(text)
    assert message in str(caught.value)
    assert caught.value.line == line
    if line is not None:
        assert f"line {line}:" in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere.yaml: cannot be read: No such file"):
        Simulation.load(tmp_path / "nowhere.yaml")


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"sim.yaml: cannot be written: No such file"):
        Simulation("iiwa14").save(tmp_path / "nowhere" / "sim.yaml")


def test_a_binary_file_is_named(tmp_path):
    path = tmp_path / "sim.yaml"
    path.write_bytes(b"PAR1\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"sim\.yaml"):
        Simulation.load(path)


HYSTERESIS = "presliding_hysteresis, joint: 1, law"
WRONG = [
    ("viscous_friction, joint: 1, f_v_plus: 1", "lacks f_v, or f_v_plus and f_v_minus"),
    ("viscous_friction, joint: 1, f_v: 1, f_v_plus: 1", "give one or other"),
    (
        "asymmetric_friction, joint: 1, tau_plus: -1, tau_minus: 1",
        "tau_plus is -1 N m, expected a num",
    ),
    (
        "load_dependent_friction, joint: 1, coefficient: 1, variant: cubic",
        "expected one of absolute, posi",
    ),
    ("load_dependent_friction, joint: 1, coefficient: 1, variant: stribeck", "lacks v_s"),
    ("load_dependent_friction, joint: 1, coefficient: 1, v_s: 1", "has no v_s as absolute"),
    ("position_dependent_friction, joint: 1, positions: [0, 1], excess: [1]", "2 positions, 1 ex"),
    ("position_dependent_friction, joint: 1, positions: [], excess: []", "0 positions, 0 excess"),
    ("position_dependent_friction, joint: 1, positions: [1, 0], excess: [1, 2]", "0 after 1"),
    ("temperature_dependent_friction, joint: 1, excess: 1", "one form, whole"),
    ("temperature_dependent_friction, joint: 1", "lacks excess and time_constant, or per_kelvin"),
    ("temperature_dependent_friction, joint: 1, excess: 1, per_kelvin: 1", "give one form"),
    (
        "torque_drift, joint: 1, times: [0, 0], offset: [1, 2]",
        "times is [0, 0], expected numbers that increase, not 0 after 0",
    ),
    ("torque_crosstalk, joint: 1, source: 1, gain: 1", "source is 1, expected another joint"),
    ("torque_crosstalk, joint: 1, source: 8, gain: 1", "source is 8, expected a joint from 1 to 7"),
    ("joint_coupling, joint: 1, other: 1, f_v: 1", "other is 1, expected another joint"),
    ("joint_coupling, joint: 1, other: 9, f_v: 1", "other is 9, expected a joint from 1 to 7"),
    ("joint_coupling, joint: 1, other: 2, ratio: 0.5", "ratio is 0.5, expected 1 or -1"),
    ("joint_coupling, other: 2", "joint_coupling: lacks joint"),
    ("torque_ripple, joint: 1, cycles_per_rev: [1, 2], amplitude: [1], phase: [0]", "1 amplitude"),
    ("payload, mass: 1, com: [0, 0]", "com is [0, 0], expected a list of 3 numbers"),
    ("payload, joint: 7, mass: 1, com: [0, 0, 0]", "has no 'joint'"),
    ("payload, mass: 1, com: [0, 0, 0], inertia: [1, 0, 0, 0.1, 0, 0.1]", "no rigid body has"),
    ("payload, mass: 0, com: [0, 0, 0], inertia: [1, 0, 0, 1, 0, 1]", "no rigid body has"),
    ("gravity_direction, gravity: [0, 0, -99]", "gravity: number 3 is -99 m/s^2, expected"),
    ("external_contact, windows: [[1, 0]], wrench: [[0, 0, 0, 0, 0, 0]]", "has to end later"),
    (
        "external_contact, windows: [[0, 1]], wrench: [[0, 0, 1]]",
        "number 1 is [0, 0, 1], expected a list of 6 numbers",
    ),
    ("external_contact, windows: [[0, 1]], wrench: []", "1 windows, 0 wrench"),
    (
        "external_contact, windows: 3, wrench: []",
        "windows is '3', expected a list of rows of 2 numbers",
    ),
    (f"{HYSTERESIS}: duhem, tau_c: 1", "law is 'duhem', expected one of maxwell_slip, lugre"),
    (f"{HYSTERESIS}: maxwell_slip, stiffness: [1]", "law maxwell_slip lacks width"),
    (f"{HYSTERESIS}: lugre, tau_c: 1", "law lugre lacks sigma_0"),
    (f"{HYSTERESIS}: dahl, sigma_0: 1, tau_c: 1, v_s: 1", "law dahl has no v_s; it has sigma_0"),
    (
        f"{HYSTERESIS}: bouc_wen, sigma_0: 1, tau_c: 1, beta_ratio: 0.4",
        "beta_ratio is 0.4, expected a number from 0.5",
    ),
    (f"{HYSTERESIS}: preisach, up: [0], down: [1], weight: [1]", "up at 0 rad, below its down"),
]


@pytest.mark.parametrize(("entry", "message"), WRONG, ids=[entry for entry, _ in WRONG])
def test_a_wrong_entry_is_named_with_its_line(tmp_path, entry, message):
    path = tmp_path / "sim.yaml"
    path.write_text(f"robot: iiwa14\neffects:\n  - {{effect: {entry}}}\n")
    with pytest.raises(ConfigError) as caught:
        Simulation.load(path)
    assert message in str(caught.value)
    assert caught.value.line == 3


def test_an_effect_of_a_joint_that_the_robot_lacks_is_refused():
    crosstalk = CATALOGUE["torque_crosstalk"](joint=1, source=8, gain=0.1)
    with pytest.raises(ConfigError, match="torque_crosstalk: joint 8 does not exist"):
        Simulation("iiwa14", effects=(crosstalk,))


def test_a_motion_without_temperature_is_refused_where_it_is_needed():
    warm = CATALOGUE["temperature_dependent_friction"](joint=3, per_kelvin=-0.1)
    zero = np.zeros((2, 7))
    with pytest.raises(ConfigError, match=r"joint 3: per_kelvin needs the temperature of the joi"):
        Simulation("iiwa14", effects=(warm,)).predict(Motion(np.arange(2.0), zero, zero, zero))


def test_a_robot_whose_name_no_file_can_have_is_no_robot(tmp_path):
    path = tmp_path / "sim.yaml"
    path.write_text(f"robot: {'a' * 4000}.urdf\n")
    with pytest.raises(ConfigError, match="neither built in"):
        Simulation.load(path)
