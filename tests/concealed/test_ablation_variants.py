"""What the ablation leaves out of the diagnosis is still where it looks for it."""

from importlib import import_module

import pytest
from ablation import SETTINGS, VARIANTS


@pytest.mark.parametrize("variant", VARIANTS)
def test_what_a_variant_changes_is_there(variant):
    change = VARIANTS[variant]
    for setting in change.settings:
        stage, group, name = setting.split(".")
        assert hasattr(getattr(import_module(f"{SETTINGS}.{stage}"), group), name)
    for function in change.functions:
        module, _, name = function.rpartition(".")
        assert callable(getattr(import_module(module), name))
