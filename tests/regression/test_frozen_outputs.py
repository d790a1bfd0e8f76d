"""What commands make of six recordings stays what was frozen, whatever moves in the code.

Three arms are simulated, and their recordings lie in `data/`; three are real, and are skipped where
their recordings are not at hand. Each stage is compared with `frozen/CASE.json`: names, order and
sentences exactly; numbers to 1e-12 of their scale on the machine that froze them, whose
fingerprint stands beside them, and elsewhere as closely as fits and sums determine them, which
`frozen_values` explains. Paths, versions of packages and checksums of files are left out.

Where numbers are meant to change, `python tests/regression/freeze.py` writes them anew; where only
sentences do, `--texts` takes over the sentences and holds everything else.
"""

from __future__ import annotations

import json

import pytest
from frozen_cases import CASES, FROZEN, STAGES, TOLERANCES, values_of
from frozen_values import SAME_MACHINE, differences, fingerprint
from lanes import sampled

SHOWN = 20  # differences of a stage

QUICK = ("identify", "diagnose", "predict")


@sampled(
    ("name", "stages"),
    [
        pytest.param("two_links", QUICK, id="two_links without models"),
        *(pytest.param(name, tuple(STAGES), id=name) for name in CASES),
    ],
    "runs four commands on each recording",
)
def test_what_the_commands_make_is_what_was_frozen(name, stages, tmp_path):
    made = CASES[name]
    if made.absent:
        pytest.skip(f"no {made.absent[0]}; name the folder of real recordings in LIMO_DATA")
    frozen = json.loads((FROZEN / f"{name}.json").read_text(encoding="utf-8"))
    made.prepare(tmp_path, frozen["stages"]["identify"]["sim"])
    same = frozen["fingerprint"] == fingerprint()
    told = []
    for stage, values in values_of(name, stages, tmp_path).items():
        tolerance = SAME_MACHINE if same else TOLERANCES[stage]
        found = differences(frozen["stages"][stage], values, tolerance, figures_in_texts=same)
        worst = sorted(found, key=lambda item: -item.size)[:SHOWN]
        if found:
            told += [f"{stage}: {len(found)} values differ, the most by:", *map(str, worst)]
    assert not told, "\n".join(told)
