"""The score counts what it says, on verdicts written by hand."""

import json
from pathlib import Path

import diagnosis_judged
import diagnosis_score as score
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from diagnosis_closure import Closure
from diagnosis_judged import Judged, coverage, misses


def effect(name="stribeck_friction", joints=(2,), **more):
    given = {"effect": name, "joints": list(joints), "equivalent": [], "law": ""}
    return given | {"parameters": {}, "size": 3.0} | more


def finding(name="stribeck_friction", joints=(2,), **more):
    given = {"effect": name, "joints": list(joints), "equivalent": [], "confidence": 0.9}
    return given | {"share": 0.5, "parameters": {}} | more


def judged(hidden, found, kind="single", verdict="explained", worst=1.0, asks=None):
    truth = {"kind": kind, "effects": hidden, "asked": [3.0], "foretellable": True}
    said = {"verdict": verdict, "findings": found, "unexplained": {"joints": []}}
    said["next_motion"] = {"separates": [asks]} if asks else None
    closure = Closure(np.full(7, 10.0), np.full(7, worst), np.ones(7))
    return Judged(Path("a"), truth, said, closure, closure, 12.0)


def values(cases):
    return {line.what: line.value for line in score.score(cases)}


def test_a_right_name_at_the_right_joint_is_exact():
    case = judged([effect()], [finding()])
    assert case.exactly_right
    assert values([case])["single 3x: exact name and joint"].split()[0] == "100.0%"


@pytest.mark.parametrize(
    ("found", "exact", "family"),
    [
        (finding("coulomb_friction"), False, True),
        (finding("payload"), False, False),
        (finding(joints=(3,)), False, True),
        (finding(joints=(2, 3)), False, True),
        (finding("backlash", equivalent=["stribeck_friction"]), True, True),
    ],
)
def test_other_names_count_as_far_as_they_go(found, exact, family):
    line = values([judged([effect()], [found])])
    assert line["single 3x: exact name and joint"].startswith("100") == exact
    assert line["single 3x: right class"].startswith("100") == family


def test_what_cannot_be_told_apart_counts():
    case = judged([effect("payload", (7,), equivalent=["link_inertia"])],
                  [finding("link_inertia", (7,))])  # fmt: skip
    assert case.exactly_right


def test_something_more_is_not_exactly_right():
    case = judged([effect()], [finding(), finding("payload", (7,), share=0.1)])
    assert case.all_named
    assert not case.exactly_right
    assert not case.classes_right


def test_false_alarms_and_abstentions_are_counted():
    null = judged([], [finding()], "null")
    quiet = judged([], [], "null", "consistent")
    line = values([null, quiet, quiet, quiet])
    assert line["false alarm on nulls"].split()[0] == "25.0%"
    unknown = finding("unknown", (2,))
    line = values([judged([effect()], [unknown]), judged([effect()], [finding(), unknown])])
    assert line["false abstention: unknown said, the name is not"].split()[0] == "50.0%"
    assert line["  unknown said beside the right names"].split()[0] == "50.0%"


@pytest.mark.parametrize(
    ("found", "right", "located"),
    [
        ([finding("unknown", (2,))], True, True),
        ([finding("unknown", (2, 5))], False, True),
        ([finding("unknown", (2,)), finding("backlash", (4,))], False, True),
        ([finding("unknown", (5,))], False, False),
        ([finding("torque_drift", (2,))], True, True),
        ([finding("backlash", (2,))], False, False),
    ],
)
def test_unknown_physics_has_to_be_called_so_at_its_joint(found, right, located):
    hidden = effect("unknown", law="jumps", equivalent=["torque_drift"])
    line = values([judged([hidden], found, "unknown")])
    assert line["unknown: said so at its joint alone, no wrong name"].startswith("100") == right
    at_joint = line["unknown: seen at its joint, whatever else is said"]
    assert at_joint.startswith("100") == located


def test_a_value_that_is_wrong_has_to_be_called_wrong():
    hidden = effect("viscous_friction", kind="wrong_parameter")
    for kind in ("missing", "wrong_parameter"):
        case = judged([hidden], [finding("viscous_friction", kind=kind)], "wrong_parameter")
        assert case.all_named
        assert case.called_wrong == (kind == "wrong_parameter")


def test_a_name_that_is_only_listed_is_counted_apart():
    line = values([judged([effect()], [finding("backlash", equivalent=["stribeck_friction"])])])
    assert line["single 3x: exact name and joint"].startswith("100")
    assert line["  by its own name, not an equivalent's"].split()[0] == "0.0%"


PAIR = ("stribeck_friction", "backlash")


def asked(name="stribeck_friction", equivalent=("backlash",), asks=PAIR):
    return judged([effect()], [finding(name, equivalent=list(equivalent))], asks=asks)


def share(pairs):
    return score.resolution(pairs)[0].value.split("(")[0].strip()


def test_a_motion_resolves_an_ambiguity_if_the_rival_asked_about_is_out():
    right = judged([effect()], [finding()])
    wrong = judged([effect()], [finding("backlash")])
    others = judged([effect()], [finding(equivalent=["encoder_offset"])])
    assert share([(asked(), right)]) == "100.0%"
    assert share([(asked("backlash", ["stribeck_friction"]), right)]) == "100.0%"
    assert share([(asked(), wrong)]) == "0.0%"
    assert share([(asked(), asked())]) == "0.0%"
    pair = [(asked(equivalent=("backlash", "encoder_offset")), others)]
    assert share(pair) == "100.0%"
    assert score.resolution(pair)[1].value.split()[0] == "0.0%"


def test_an_ambiguity_without_a_motion_stays_unresolved():
    assert share([(asked(asks=None), None)]) == "0.0%"
    assert score.resolution([(asked(asks=None), None)])[2].value == "1 of 1"


def test_only_what_can_be_told_apart_is_ambiguous():
    assert share([(asked(equivalent=()), None)]) == "no case"
    identical = asked(asks=None)
    identical.truth["effects"][0]["equivalent"] = ["backlash"]
    assert share([(identical, None)]) == "no case"
    claimed = asked()
    claimed.truth["effects"][0]["equivalent"] = ["backlash"]
    assert share([(claimed, claimed)]) == "0.0%"
    missed = judged([effect()], [finding("payload", (7,), equivalent=["link_inertia"])])
    assert share([(missed, None)]) == "no case"


def test_confidence_is_compared_with_what_is_right():
    assert score.calibration_error([(0.95, True)] * 95 + [(0.95, False)] * 5) < 1e-9
    assert score.calibration_error([(0.95, False)] * 10) == pytest.approx(0.95)


def test_intervals_are_held_to_the_same_parameter():
    true = effect(parameters={"tau_s": 1.0, "v_s": 0.02, "delta": 2.0})
    said = {"tau_s": {"ci95": [0.9, 1.1]}, "v_s": {"ci95": [0.03, 0.04]}}
    assert coverage(finding(parameters=said), true) == [True, False]
    assert coverage(finding("backlash", parameters=said), true) == []


def test_a_value_is_off_in_halves_of_its_interval():
    true = effect(parameters={"tau_s": 1.0, "v_s": 0.02})
    said = {"tau_s": {"ci95": [0.7, 1.1]}, "v_s": {"ci95": [0.03, 0.05]}}
    assert misses(finding(parameters=said), true) == pytest.approx([0.5, -2.0])
    assert misses(finding(parameters={"tau_s": {"ci95": None}}), true) == []


def test_intervals_of_lists_count_entry_by_entry_and_of_another_variant_not_at_all():
    load = effect("load_dependent_friction", parameters={"coefficient": 0.1, "variant": "positive"})
    said = {"coefficient": {"ci95": [0.09, 0.11]}, "variant": {"value": "absolute"}}
    assert coverage(finding("load_dependent_friction", parameters=said), load) == []
    said["variant"]["value"] = "positive"
    assert coverage(finding("load_dependent_friction", parameters=said), load) == [True]
    payload = effect("payload", (7,), parameters={"com": [0.0, 0.1, 0.2]})
    said = {"com": {"ci95": [[-1, 1], [0.2, 0.3], [0.1, 0.3]]}}
    assert coverage(finding("payload", (7,), parameters=said), payload) == [True, False, True]
    crosstalk = effect("torque_crosstalk", parameters={"source": 3})
    said = {"source": {"ci95": [3, 3]}}
    assert coverage(finding("torque_crosstalk", parameters=said), crosstalk) == []


def test_shares_come_with_clopper_pearson():
    assert score.rate("x", [True] * 10, "").value == "100.0%  (10 of 10; 69.2% to 100.0%)"


def test_closure_of_a_perfect_prediction_is_one(tmp_path):
    random = np.random.default_rng(0)
    (tmp_path / "hidden").mkdir()
    (tmp_path / "out").mkdir()
    time = np.arange(0, 20, 0.004)
    position = np.sin(time[:, None] * np.linspace(0.5, 1, 7))
    clean = 10 * np.cos(time[:, None] * np.ones(7))
    torque = clean + 0.1 * random.normal(size=clean.shape)

    def write(path, **quantities):
        columns = {"time": time}
        for name, value in quantities.items():
            columns |= {f"{name}_{j + 1}": value[:, j] for j in range(7)}
        pq.write_table(pa.table(columns), path)

    for k in (1, 2):
        write(tmp_path / f"held_out_{k}.parquet", position=position, torque=torque)
        np.savez(tmp_path / "hidden" / f"held_out_{k}.npz", torque=clean)
        write(tmp_path / "out" / f"after_{k}.parquet", torque=clean)
        write(tmp_path / "out" / f"before_{k}.parquet", torque=0.5 * clean)
    truth = {"kind": "null", "effects": [], "asked": [], "foretellable": True}
    (tmp_path / "hidden" / "truth.json").write_text(json.dumps(truth))
    (tmp_path / "out" / "result.json").write_text(json.dumps({"status": 0, "seconds": 1.0}))
    case = diagnosis_judged.judge(tmp_path)
    assert case.closure is not None
    assert case.closure.worst == pytest.approx(1.0)
    assert case.closure.removed == pytest.approx(1.0)
    assert case.verdict is None
