import inspect
import subprocess
import sys
from importlib.metadata import version

import pytest

import limo_driver

WORDS = ("Args:", "Raises:", "Example:")  # what the help of a function or a class says
FUNCTIONS = [name for name in limo_driver.__all__ if inspect.isfunction(getattr(limo_driver, name))]
CLASSES = [name for name in limo_driver.__all__ if inspect.isclass(getattr(limo_driver, name))]


def undescribed(member, text):
    """Arguments of a function or a class that its help does not name; an error takes any."""
    is_error = inspect.isclass(member) and issubclass(member, Exception)
    arguments = ["args"] if is_error else inspect.signature(member).parameters
    described = text.partition("Args:")[2]
    return [name for name in arguments if name != "self" and f"{name}:" not in described]


def methods(owner):
    """Public methods of a class that take arguments, of our own and of the bases of ours."""
    for name, member in inspect.getmembers(owner, inspect.isroutine):
        if not callable(member):  # a cached property is a routine to Python 3.13
            continue
        is_ours = not name.startswith("_") and getattr(member, "__module__", "").startswith("limo")
        if is_ours and set(inspect.signature(member).parameters) - {"self"}:
            yield name, member


@pytest.mark.parametrize("name", limo_driver.__all__)
def test_every_exported_name_exists(name):
    assert getattr(limo_driver, name).__name__ == name


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_of_a_function_says_what_goes_in_and_how_it_is_used(name):
    text = inspect.getdoc(getattr(limo_driver, name))
    assert [word for word in WORDS if word not in text] == []
    assert undescribed(getattr(limo_driver, name), text) == []


@pytest.mark.parametrize("name", CLASSES)
def test_help_of_a_class_says_what_it_is_made_of_and_how_it_is_used(name):
    owner = getattr(limo_driver, name)
    text = inspect.getdoc(owner)
    wanted = ("Args:", "Example:") if issubclass(owner, Exception) else WORDS
    assert [word for word in wanted if word not in text] == []
    assert undescribed(owner, text) == []


@pytest.mark.parametrize("name", CLASSES)
def test_help_of_a_method_says_what_goes_in_and_what_comes_out(name):
    owner = getattr(limo_driver, name)
    for called, method in methods(owner):
        text = inspect.getdoc(method)
        assert undescribed(method, text) == [], called
        made = inspect.signature(method).return_annotation
        makes_itself = inspect.ismethod(method) and made in {c.__name__ for c in owner.__mro__}
        if made not in {"None", None} and not makes_itself:
            assert "Returns:" in text or text.startswith("Return "), called


def test_what_is_exported_can_be_looked_up():
    own = {name for name in dir(limo_driver) if not name.startswith("__")}
    assert own == set(limo_driver.__all__)
    assert limo_driver.__version__ == version("limo")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'Robots'"):
        _ = limo_driver.Robots


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, limo_driver; dir(limo_driver); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
