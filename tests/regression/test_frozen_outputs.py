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

pytestmark = pytest.mark.slow(why="all commands on six recordings: two minutes")


@pytest.fixture(scope="module", params=CASES)
def frozen(request, tmp_path_factory):
    """Prepare one case, and read what is frozen of it."""
    case = CASES[request.param]
    if case.absent:
        pytest.skip(f"no {case.absent[0]}; name the folder of real recordings in LIMO_DATA")
    content = json.loads((FROZEN / f"{request.param}.json").read_text(encoding="utf-8"))
    folder = tmp_path_factory.mktemp(request.param)
    case.prepare(folder, content["stages"]["identify"]["sim"])
    return case, content, folder


@pytest.mark.parametrize("stage", STAGES)
def test_what_the_commands_make_is_what_was_frozen(frozen, stage):
    case, content, folder = frozen
    same = content["fingerprint"] == fingerprint()
    found = differences(
        content["stages"][stage],
        values_of(case, stage, folder),
        SAME_MACHINE if same else case.tolerance_elsewhere(stage),
        figures_in_texts=same,
    )
    worst = sorted(found, key=lambda item: -item.size)[:SHOWN]
    told = "\n".join(map(str, worst))
    assert not found, f"{len(found)} values differ, the most by:\n{told}"
