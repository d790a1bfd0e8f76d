"""Draft: an effect before its amplitude is known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from world import World


def _no_parameters(_amplitude: float) -> dict:
    return {}


@dataclass(frozen=True)
class Place:
    """Where an effect is to be, and what draws it."""

    random: np.random.Generator
    j: int  # joint, 0-based
    floor: float  # [N m] noise floor of that joint
    world: World  # without effects


@dataclass(frozen=True)
class Draft:
    effect: str  # ID, `unknown` outside the catalogue
    joints: tuple[int, ...]  # 1-based; all that a diagnosis may rightly name
    guess: float  # amplitude with which the search begins
    largest: float  # amplitude that is still plausible
    change: Callable[[World, float], World]
    parameters: Callable[[float], dict] = _no_parameters  # those that the catalogue has too
    equivalent: tuple[str, ...] = ()  # IDs that no such recording can tell apart from it
    kind: str = "missing"
    predictable: bool = True  # on another motion, by someone who knows this one
    law: str = ""  # the plant's own name of it
    scale: float = 1.0  # share of the true effect that the nominal model lacks
    wrong: str = ""  # parameter whose value in the nominal file is wrong
