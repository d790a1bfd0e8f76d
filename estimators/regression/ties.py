"""Ties: of explanations whose evidence differs by rounding alone, the first one counts.

Two sets of columns may be one and the same in other words, as a load and a heavier last link are,
and a member that brings nothing leaves a set as likely as it was. Which of two such sums comes out
larger is up to the last bit, and so to the processor. So what is not clearly more is no more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

ALIKE: Final = 1e-6  # [nat], a difference that nobody could tell; sums of 1e6 nat are as exact
_OF_LARGE: Final = 1e-9  # the same of larger values

_Item = TypeVar("_Item")


def is_more(value: float, than: float) -> bool:
    """Say whether a value is larger than another by more than rounding."""
    alike = max(ALIKE, _OF_LARGE * min(abs(value), abs(than)))  # either may be infinite
    return value > than and value - than > alike


def best_first(values: FloatArray) -> NDArray[np.int64]:
    """Return the places of values (k,), the largest first, and of those alike the first one."""
    order = np.argsort(-values, kind="stable")
    falling = np.nan_to_num(values[order])  # what is out of the question is -inf
    apart = falling[:-1] - falling[1:] > np.maximum(ALIKE, _OF_LARGE * np.abs(falling[1:]))
    step = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(apart)])[: order.size]
    return order[np.lexsort((order, step))]


def ranked(items: Iterable[_Item], value: Callable[[_Item], float]) -> list[_Item]:
    """Return items by their values, the best first; those alike stay in their order."""
    every = list(items)
    return [every[k] for k in best_first(np.array([value(item) for item in every], dtype=float))]


def first_best(items: Iterable[_Item], value: Callable[[_Item], float]) -> _Item:
    """Return the item of the largest value, and of those alike the first one."""
    return ranked(items, value)[0]
