"""A wheel in an empty environment, without the checkout: commands run, and find their data.

It is built from the archive of the sources, as a release is.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("limo_driver", "backends", "estimators", "limopa")


def run(words, **given):
    done = subprocess.run(words, capture_output=True, text=True, check=False, **given)
    assert done.returncode == 0, f"{words}:\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    try:
        run([sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)])
    except AssertionError as error:
        if "No matching distribution found for hatchling" in str(error):
            pytest.skip("the builder of wheels is not to be had without a network")
        raise
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def limo(wheel, tmp_path_factory):
    """The command of an environment that has the wheel and what it depends on, and no checkout.

    Dependencies are taken from this environment by a path file: downloading them again takes
    minutes, and what is tried is the wheel.
    """
    home = tmp_path_factory.mktemp("environment")
    run([sys.executable, "-m", "venv", str(home)])
    site = next((home / "lib").glob("python*/site-packages"))
    run([str(home / "bin" / "pip"), "--disable-pip-version-check", "install", "--quiet",
         "--no-deps", str(wheel)])  # fmt: skip
    here = {str(Path(found.locate_file("")).resolve()) for found in distributions()}
    lines = [f"import site; site.addsitedir({p!r})" for p in sorted(here) if "-packages" in p]
    (site / "dependencies.pth").write_text("\n".join(lines) + "\n")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    elsewhere = tmp_path_factory.mktemp("elsewhere")

    def command(*words):
        return run([str(home / "bin" / "limo"), *words], cwd=elsewhere, env=environment)

    where = run(
        [str(home / "bin" / "python"), "-c", "import limo_driver; print(limo_driver.__file__)"],
        cwd=elsewhere, env=environment,
    )  # fmt: skip
    assert Path(where.strip()).is_relative_to(site)
    return command, elsewhere


@pytest.mark.slow("builds a wheel")
def test_the_wheel_has_all_files_of_the_packages_and_nothing_else(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    files = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = run([*files, *PACKAGES], cwd=ROOT).splitlines()
    assert names == {name for name in listed if (ROOT / name).exists()}


@pytest.mark.slow("builds a wheel")
def test_the_wheel_has_the_licences_of_what_pages_are_drawn_with(wheel):
    archive = zipfile.ZipFile(wheel)
    vendor = "limo_driver/pages/static/vendor/"
    names = archive.namelist()
    about = next(name.removesuffix("METADATA") for name in names if name.endswith("/METADATA"))
    metadata = archive.read(f"{about}METADATA").decode()
    assert "License-Expression: Apache-2.0 AND MIT\n" in metadata
    for file in ("LICENSE", f"{vendor}LICENSE.three", f"{vendor}LICENSE.plotly"):
        assert f"License-File: {file}\n" in metadata
        assert archive.read(f"{about}licenses/{file}") == (ROOT / file).read_bytes()


@pytest.mark.slow("builds a wheel, and installs it")
def test_a_user_of_pip_has_the_command_and_the_arm_that_is_built_in(limo):
    command, folder = limo
    assert "diagnose" in command("--help")
    command("demo", "--out", "demo")
    assert (folder / "demo" / "report.html").exists()
