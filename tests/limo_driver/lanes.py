"""Cases of which `make test` tries the first ones only."""

import pytest


def sampled(names, cases, why, first=1, **options):
    """Parametrize a test, and mark all cases but the first ones as slow.

    Args:
        names, cases, options: As of `pytest.mark.parametrize`.
        why: Why not all cases are tried at once.
        first: How many are.
    """
    cases, mark = list(cases), pytest.mark.slow(why)
    alone = isinstance(names, str)
    later = [pytest.param(*((case,) if alone else case), marks=mark) for case in cases[first:]]
    return pytest.mark.parametrize(names, cases[:first] + later, **options)
