import inspect
import subprocess
import sys
from importlib.metadata import version

import pytest

import limo_driver

WORDS = ("Args:", "Raises:", "Example:")  # what the help of a function says
FUNCTIONS = [name for name in limo_driver.__all__ if inspect.isfunction(getattr(limo_driver, name))]


@pytest.mark.parametrize("name", limo_driver.__all__)
def test_every_exported_name_exists(name):
    assert getattr(limo_driver, name).__name__ == name


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_of_a_function_says_what_goes_in_and_how_it_is_used(name):
    text = inspect.getdoc(getattr(limo_driver, name))
    assert [word for word in WORDS if word not in text] == []
    arguments = inspect.signature(getattr(limo_driver, name)).parameters
    described = text.partition("Args:")[2]
    assert [argument for argument in arguments if f"{argument}:" not in described] == []


def test_what_is_exported_can_be_looked_up():
    assert set(limo_driver.__all__) <= set(dir(limo_driver))
    assert limo_driver.__version__ == version("limo")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'Robots'"):
        _ = limo_driver.Robots


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, limo_driver; dir(limo_driver); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
