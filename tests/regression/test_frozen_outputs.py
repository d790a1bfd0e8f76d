"""What commands make of six recordings stays what was frozen, whatever moves in the code.

Three arms are simulated, and their recordings lie in `data/`; three are real, and are skipped where
their recordings are not at hand. Each stage is compared with `frozen/CASE.json`: names, order and
sentences exactly; numbers to 1e-12 of their scale on the machine that froze them, whose
fingerprint stands beside them, and more loosely elsewhere, as `frozen_values` explains. Paths,
versions of packages and checksums of files are left out.

Where numbers are meant to change, `python tests/regression/freeze.py` writes them anew; where only
sentences do, `--texts` takes over the sentences and holds everything else.
"""

from __future__ import annotations

import json

import pytest
from frozen_cases import CASES, FROZEN, STAGES, values_of
from frozen_values import SAME_MACHINE, differences, fingerprint

SHOWN = 20  # differences of a stage

pytestmark = pytest.mark.slow("all commands on six recordings: two minutes")


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory):
    """Compute one case, and read what is frozen of it."""
    name, made = request.param, CASES[request.param]
    if made.absent:
        pytest.skip(f"no {made.absent[0]}; name the folder of real recordings in LIMO_DATA")
    frozen = json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))
    folder = tmp_path_factory.mktemp(name)
    made.prepare(folder, frozen["stages"]["identify"]["sim"])
    return made, frozen, values_of(name, tuple(STAGES), folder)


@pytest.mark.parametrize("stage", STAGES)
def test_what_the_commands_make_is_what_was_frozen(case, stage):
    made, frozen, values = case
    same = frozen["fingerprint"] == fingerprint()
    tolerance = SAME_MACHINE if same else made.tolerance_elsewhere(stage)
    found = differences(frozen["stages"][stage], values[stage], tolerance, figures_in_texts=same)
    worst = sorted(found, key=lambda item: -item.size)[:SHOWN]
    told = "\n".join(map(str, worst))
    assert not found, f"{len(found)} values differ, the most by:\n{told}"
