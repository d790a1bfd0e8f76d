"""Search: planted sets are found, also those that the best single effect leads away from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
from estimators.diagnosis.from_torque.hypotheses.search import Search
from estimators.diagnosis.settings.fitting import CANDIDATES, SEARCH
from estimators.regression.evidence import Evidence, NormalEquations, Prior

ROWS = 400
EFFECTS = (
    "viscous_friction",
    "coulomb_friction",
    "torque_gain",
    "armature",
    "backlash",
    "spring_load",
    "torque_ripple",
    "quadratic_drag",
)


@pytest.fixture(scope="module")
def columns():
    """Twelve columns of white noise and a blend of the first two that fits neither."""
    random = np.random.default_rng(11)
    columns = random.standard_normal((ROWS, 13))
    columns[:, 12] = columns[:, 0] + columns[:, 1] + 0.5 * columns[:, 12]
    return columns


def candidate(at, *, effect=None, joint=None, variants=1, positive=False):
    return Candidate(
        effect=effect or EFFECTS[at % 8],
        joints=(at // 8 if joint is None else joint,),
        kind="missing",
        prior=Prior(np.array([at]), np.ones(1), np.array([positive])),
        enter=lambda _improvement, _c: None,
        variants=variants,
    )


def search_of(columns, y, candidates=None, base=()):
    products = NormalEquations(columns.T @ columns, columns.T @ y)
    nuisance = Prior.free(np.array([11]), np.array([0.1]))
    given = candidates or [candidate(at) for at in (*range(11), 12)]
    return Search(given, Evidence(products, nuisance), base)


def noise(seed):
    return np.random.default_rng(seed).standard_normal(ROWS)


def names(search, found):
    return {int(search.candidates[i].prior.index[0]) for i in found.members}


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_explained_by_nothing(columns, seed):
    found = search_of(columns, noise(seed)).best()
    assert found.members == ()
    assert found.gain == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_pair_that_greedy_addition_misses_is_found(columns, seed):
    y = columns[:, 0] + columns[:, 1] + noise(seed)
    search = search_of(columns, y)
    assert names(search, search.ranked((), 1)[0]) == {12}  # greedy starts with the blend
    assert names(search, search.best()) == {0, 1}


@pytest.mark.parametrize("seed", range(4))
def test_a_member_chosen_too_early_is_taken_out_again(columns, seed, monkeypatch):
    narrow = replace(SEARCH, width=1)  # greedy: the blend comes first
    monkeypatch.setattr("estimators.diagnosis.from_torque.hypotheses.search.SEARCH", narrow)
    search = search_of(columns, 3 * (columns[:, 0] + columns[:, 1]) + noise(seed))
    assert names(search, search.best()) == {0, 1}


@pytest.mark.parametrize("seed", range(4))
def test_a_member_chosen_too_early_gives_way_where_the_set_is_full(columns, seed, monkeypatch):
    """Without the blend one effect alone explains less, and beside it no other has room."""
    full = replace(SEARCH, width=1, largest=2)
    monkeypatch.setattr("estimators.diagnosis.from_torque.hypotheses.search.SEARCH", full)
    search = search_of(columns, 3 * (columns[:, 0] + columns[:, 1]) + noise(seed))
    assert names(search, search.best()) == {0, 1}


def test_four_effects_are_found(columns):
    y = columns[:, [2, 4, 7, 9]] @ np.array([0.5, -0.6, 0.4, 0.8]) + noise(3)
    search = search_of(columns, y)
    assert names(search, search.best()) == {2, 4, 7, 9}


def test_a_set_is_no_larger_than_the_largest(columns):
    search = search_of(columns, columns[:, :11].sum(axis=1))
    assert len(search.best().members) <= SEARCH.largest


def test_a_base_does_not_count_and_leaves_room_for_the_largest_set(columns, monkeypatch):
    monkeypatch.setattr(
        "estimators.diagnosis.from_torque.hypotheses.search.SEARCH", replace(SEARCH, largest=2)
    )
    search = search_of(columns, columns[:, :8].sum(axis=1) + noise(1), base=tuple(range(6)))
    assert names(search, search.best()) == set(range(8))


def test_what_a_base_has_and_the_recordings_do_not_speak_for_is_taken_out(columns):
    search = search_of(columns, columns[:, 0] + columns[:, 3] + noise(2), base=(0, 1, 2))
    assert names(search, search.best()) == {0, 3}


def test_what_a_set_does_not_need_is_taken_out_one_after_the_other(columns):
    search = search_of(columns, columns[:, 0] + columns[:, 2] + columns[:, 4] + noise(2))
    assert search.around((0, 1, 2, 3, 4)).members == (0, 2, 4)


def test_only_one_variant_of_an_effect_at_a_place_is_taken(columns):
    y = columns[:, 0] + columns[:, 1] + noise(4)
    pair = [candidate(at, effect="spring_load", joint=2, variants=2) for at in (0, 1)]
    search = search_of(columns, y, [*pair, candidate(2), candidate(3)])
    assert len(search.best().members) == 1


def test_a_positive_effect_is_not_named_for_its_opposite(columns):
    y = -0.8 * columns[:, 0] + noise(5)
    search = search_of(columns, y, [candidate(0, positive=True), candidate(1)])
    assert search.best().members == ()


@pytest.mark.parametrize(
    "pair",
    [("coulomb_friction", "asymmetric_friction"), ("link_inertia", "payload")],
)
def test_of_two_effects_of_which_one_is_part_of_the_other_one_is_taken(columns, pair):
    y = 3 * (columns[:, 0] + columns[:, 1]) + noise(4)
    both = [candidate(at, effect=effect, joint=2) for at, effect in enumerate(pair)]
    search = search_of(columns, y, [*both, candidate(2), candidate(3)])
    assert len(search.best().members) == 1
    elsewhere = [both[0], candidate(1, effect=pair[1], joint=3)]
    assert len(search_of(columns, y, elsewhere).best().members) == 2


def test_gain_is_log_evidence_less_the_rarity_of_each_place_and_variant(columns):
    y = columns[:, 0] + noise(6)
    few = [candidate(0, variants=3), candidate(1), candidate(2)]
    search = search_of(columns, y, few)
    price = 2 * CANDIDATES.missing + np.log(3)
    evidence = search.evidence.gain(search.prior((0, 2)))
    assert search.gain((2, 0)) == pytest.approx(evidence - price)


@pytest.mark.parametrize("rare", [3, 6])
def test_of_two_that_bring_as_much_the_one_of_fewer_variants_is_added(columns, rare):
    some = [candidate(at, variants=10**18 if at == rare else 1) for at in (3, 6)]
    search = search_of(columns, columns[:, 3] + columns[:, 6] + noise(7), some)
    (first,) = search.ranked((), 1)
    assert names(search, first) == {3, 6} - {rare}


def test_ranked_additions_are_best_first(columns):
    y = columns[:, 3] + 0.5 * columns[:, 6] + noise(7)
    search = search_of(columns, y)
    ranked = search.ranked((3,), 5)
    assert names(search, ranked[0]) == {3, 6}
    assert [item.gain for item in ranked] == sorted((i.gain for i in ranked), reverse=True)
    assert len(ranked) == 5


def test_a_candidate_that_passes_is_no_part_of_an_improved_simulation():
    kinds = ("torque_drift", "presliding_hysteresis", "link_inertia")  # the last is no effect
    assert [candidate(0, effect=effect).persists for effect in kinds] == [False, True, True]


@pytest.mark.parametrize("last_bit", [-1e-13, 0.0, 1e-13])
def test_of_two_names_for_the_same_columns_the_first_one_is_chosen(columns, last_bit):
    same = columns.copy()
    same[:, 5] = (1.0 + last_bit) * same[:, 2]
    y = 3.0 * same[:, 2] + noise(3)
    assert search_of(same, y).best().members == (2,)
    assert search_of(same, y).ranked((), 2)[0].members == (2,)


@pytest.mark.parametrize("last_bit", [-1e-13, 0.0, 1e-13])
def test_what_costs_nothing_and_brings_nothing_is_no_member(columns, last_bit):
    """A coefficient that would need the other sign leaves a set as likely as it is without."""
    same = columns.copy()
    same[:, 4] = -(1.0 + last_bit) * same[:, 2]
    free = [
        candidate(2),
        replace(candidate(4, positive=True), kind="deviating"),
    ]
    search = search_of(same, 30.0 * same[:, 2] + noise(4), free)
    search._prices[:] = 0.0
    assert search.best().members == (0,)
    assert search.around((0,)).members == (0,)
