"""An arm without torque, exports and a session of the service stay what was frozen, too."""

from __future__ import annotations

import json

import pytest
from frozen_cases import FROZEN
from frozen_values import FITS, SAME_MACHINE, differences, fingerprint
from small_cases import ELSEWHERE, SMALL, small_values

pytestmark = pytest.mark.slow("runs commands in processes of their own")


@pytest.mark.parametrize("name", SMALL)
def test_what_is_made_is_what_was_frozen(name, tmp_path):
    frozen = json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))
    same = frozen["fingerprint"] == fingerprint()
    tolerance = SAME_MACHINE if same else ELSEWHERE.get(name, FITS)
    values = small_values(name, tmp_path)
    found = differences(frozen["stages"], values, tolerance, figures_in_texts=same)
    told = "\n".join(map(str, sorted(found, key=lambda item: -item.size)[:20]))
    assert not found, f"{len(found)} values differ, the most by:\n{told}"
