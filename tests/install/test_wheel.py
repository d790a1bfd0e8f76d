"""A wheel in an empty environment, without the checkout: commands run, the demo has its data."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(words, **given):
    done = subprocess.run(words, capture_output=True, text=True, check=False, **given)
    assert done.returncode == 0, f"{words}:\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet"]
    try:
        run([*pip, "--no-deps", "--wheel-dir", str(folder), str(ROOT)])
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
def test_the_wheel_has_what_pages_are_drawn_with_and_its_licences(wheel):
    archive = zipfile.ZipFile(wheel)
    names = archive.namelist()
    vendor = "limo_driver/pages/static/vendor/"
    for name in ("three.min.js", "LICENSE.three", "plotly-cartesian.min.js", "LICENSE.plotly"):
        assert vendor + name in names
    about = next(name.removesuffix("METADATA") for name in names if name.endswith("/METADATA"))
    metadata = archive.read(f"{about}METADATA").decode()
    assert "License-Expression: Apache-2.0 AND MIT\n" in metadata
    for file in ("LICENSE", f"{vendor}LICENSE.three", f"{vendor}LICENSE.plotly"):
        assert f"License-File: {file}\n" in metadata
        assert archive.read(f"{about}licenses/{file}") == (ROOT / file).read_bytes()
    assert not [name for name in names if name.startswith(("tests/", "docs/", "examples/"))]


@pytest.mark.slow("builds a wheel, and diagnoses")
def test_a_user_of_pip_has_the_first_report(limo):
    command, folder = limo
    assert "limo diagnose" in command("--help") or "diagnose" in command("--help")
    said = command("demo", "--out", "demo")
    assert "payload of 0.8 kg" in said
    assert (folder / "demo" / "report.html").stat().st_size < 3e6
    command("inspect", "demo/run.parquet", "--robot", "iiwa14")
    command("export", "demo/sim.yaml", "--to", "urdf", "--out", "improved")
    assert list((folder / "improved").glob("*.urdf"))
