"""Outputs: what cannot be written, or is read, is refused before any work."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from limo_driver.app.cli import main
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import (
    only_writer,
    require_apart,
    require_file,
    require_folder,
    require_place,
)


@pytest.fixture
def there(tmp_path):
    path = tmp_path / "there.parquet"
    path.write_bytes(b"read")
    return path


def test_a_file_that_can_be_written_is_neither_made_nor_changed(there, tmp_path):
    require_file(there, [tmp_path / "another.parquet"])
    require_file(tmp_path / "new.parquet", [there])
    assert there.read_bytes() == b"read"
    assert not (tmp_path / "new.parquet").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (".", "it is a folder, expected a file"),
        ("nowhere/new.yaml", "there is no folder"),
        ("/proc/new.yaml", "cannot be written: "),
        ("../{folder}/there.parquet", "is read and would be written over"),
    ],
)
def test_a_file_that_cannot_be_is_refused_by_name(there, name, said):
    path = there.parent / name.format(folder=there.parent.name)
    with pytest.raises(ConfigError, match=said):
        require_file(path, [there])
    assert there.read_bytes() == b"read"


def test_a_folder_is_made_and_an_input_in_it_is_kept(there, tmp_path):
    require_folder(tmp_path / "deep" / "out", "the diagnosis", ["report.html"], [there])
    assert (tmp_path / "deep" / "out").is_dir()
    with pytest.raises(ConfigError, match="expected a folder for the diagnosis"):
        require_folder(there, "the diagnosis")
    with pytest.raises(ConfigError, match=r"there\.parquet: is read and would be written over"):
        require_folder(tmp_path, "the diagnosis", ["there.parquet"], [there])


def test_a_place_is_checked_and_nothing_is_made(there, tmp_path):
    require_place(tmp_path / "deep" / "out", "the diagnosis", ["report.html"], [there])
    assert list(tmp_path.iterdir()) == [there]
    for place, said in (
        (there, "expected a folder for the diagnosis"),
        (there / "below", "cannot be written to"),
        (Path("/proc/nowhere"), "cannot be written to"),
    ):
        with pytest.raises(ConfigError, match=said):
            require_place(place, "the diagnosis")
    with pytest.raises(ConfigError, match=r"there\.parquet: is read and would be written over"):
        require_place(tmp_path, "the diagnosis", ["there.parquet"], [there])


def test_a_link_to_an_input_is_that_input(there, tmp_path):
    (tmp_path / "link").symlink_to(there)
    with pytest.raises(ConfigError, match="would be written over"):
        require_apart([tmp_path / "link"], [there])


def test_a_folder_has_one_writer_at_a_time(tmp_path):
    with only_writer(tmp_path):
        second = only_writer(tmp_path)
        with pytest.raises(ConfigError, match="another process is writing to it"):
            second.__enter__()
    with only_writer(tmp_path):
        assert tmp_path.is_dir()


@pytest.mark.parametrize(
    "arguments",
    [
        ("predict", "{it}", "--sim", "sim.yaml", "--out", "{it}"),
        ("predict", "run.parquet", "--sim", "{it}", "--out", "{it}"),
        ("identify", "run.parquet", "{it}", "--robot", "iiwa14", "--out", "{it}"),
        ("run", "--backend", "virtual", "--trajectory", "{it}", "--record", "{it}"),
    ],
)
def test_no_command_writes_over_what_it_reads(there, arguments, monkeypatch, capsys):
    words = [word.format(it=there) for word in arguments]
    monkeypatch.setattr(sys, "argv", ["limo", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("is read and would be written over") == 1
    assert there.read_bytes() == b"read"
