"""Every exception of the packages comes back from another process as it was."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from limo_driver.logs.readers.table import LogTable
from limo_driver.model import RobotModel

ROOT = Path(__file__).parents[2]
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")
CLASS = re.compile(r"^class (\w+)\(.*(?:Error|Exception|Interrupt)\b.*\):", re.MULTILINE)
TEXTS, WHOLE = st.text(), st.integers(0, 2**40)
NUMBERS = st.floats(allow_nan=False)
KINDS = {
    "str": TEXTS,
    "int": WHOLE,
    "float": NUMBERS,
    "int | None": st.none() | WHOLE,
    "Path | str | None": st.none() | TEXTS | st.just(Path("run.parquet")),
    "Iterable[str]": st.lists(TEXTS),
    "Iterable[int]": st.lists(WHOLE),
    "tuple[int, ...]": st.lists(WHOLE).map(tuple),
    "tuple[float, float]": st.tuples(NUMBERS, NUMBERS),
    "LogTable": st.builds(lambda: LogTable({"time": np.arange(3.0)})),
    "RobotModel": st.builds(RobotModel.load, st.just("iiwa14")),
}


def all_of_them():
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        if names := CLASS.findall(path.read_text("utf-8")):
            module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
            yield from (getattr(module, name) for name in names)


ERRORS = list(all_of_them())


@st.composite
def made(draw, kind):
    positional, named = [], {}
    own = inspect.isfunction(kind.__init__)  # else the builtin's, which takes any message
    for parameter in inspect.signature(kind).parameters.values() if own else ():
        if parameter.kind is parameter.VAR_POSITIONAL:
            positional.append(draw(TEXTS))  # one sentence
            continue
        value = draw(KINDS[parameter.annotation])
        if parameter.kind is parameter.KEYWORD_ONLY:
            named[parameter.name] = value
        else:
            positional.append(value)
    return kind(*positional, **named) if own else kind(draw(TEXTS))


@pytest.mark.parametrize("kind", ERRORS, ids=lambda kind: kind.__name__)
@given(data=st.data())
def test_it_comes_back_from_a_pickle(kind, data):
    error = data.draw(made(kind))
    sent = pickle.loads(pickle.dumps(error))  # noqa: S301  # of this test
    for again in (sent, copy.copy(error)):
        assert type(again) is kind
        assert (str(again), again.args) == (str(error), error.args)
        assert vars(again) == vars(error)


def test_none_is_left_out():
    assert {"InfeasiblePathError", "SdoAbortError", "_Refused", "NothingProposedError"} <= {
        kind.__name__ for kind in ERRORS
    }
    assert all(issubclass(kind, BaseException) for kind in ERRORS)
