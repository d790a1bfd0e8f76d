"""The oracle knows the name of what is hidden, and removes its error from other motion."""

import cases
import pytest
from diagnosis_closure import closure
from diagnosis_oracle import write_oracle
from variant import Variant


@pytest.mark.slow("draws a whole case, and fits what is hidden in it")
def test_what_is_hidden_is_fitted_so_that_it_predicts_other_motion(tmp_path):
    cases.draw(20, "single", Variant(seconds=8.0), only="viscous_friction").write(tmp_path)
    write_oracle(tmp_path)
    reached = closure(tmp_path, "oracle")
    assert reached is not None
    assert (reached.before / reached.floor).max() > 5.0
    assert reached.removed > 0.95
