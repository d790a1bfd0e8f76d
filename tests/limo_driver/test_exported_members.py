import subprocess
import sys

import pytest

import limo_driver


@pytest.mark.parametrize("name", limo_driver.__all__)
def test_every_exported_name_exists(name):
    assert getattr(limo_driver, name).__name__ == name


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'Robots'"):
        _ = limo_driver.Robots


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, limo_driver; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
