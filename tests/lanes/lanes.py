"""Cases of which `make test` tries the first ones only."""

import pytest

GIVEN = type(pytest.param())  # a case that has an id or marks of its own


def later(cases, why, first=1):
    """Mark all cases but the first ones as slow, for `params` of a fixture or a parametrized test.

    Args:
        cases: Values, or what `pytest.param` makes of them.
        why: Why not all cases are tried at once.
        first: How many are.
    """
    cases, mark = list(cases), pytest.mark.slow(why)
    given = [case if isinstance(case, GIVEN) else pytest.param(case) for case in cases[first:]]
    marked = [pytest.param(*x.values, marks=(*x.marks, mark), id=x.id) for x in given]
    return cases[:first] + marked


def sampled(names, cases, why, first=1, **options):
    """Parametrize a test, and mark all cases but the first ones as slow.

    Args:
        names, cases, options: As of `pytest.mark.parametrize`.
        why: Why not all cases are tried at once.
        first: How many are.
    """
    alone = isinstance(names, str)
    cases = [x if alone or isinstance(x, GIVEN) else pytest.param(*x) for x in cases]
    return pytest.mark.parametrize(names, later(cases, why, first), **options)
