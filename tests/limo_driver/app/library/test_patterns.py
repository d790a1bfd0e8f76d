"""Patterns find each file once, and come to an end where links lead round and round."""

import pytest

from limo_driver.app.library.fleets import files_of


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Two arms, a folder elsewhere that is linked, and links that lead back."""
    for name in ("arms/a/1.csv", "arms/a/old/2.csv", "arms/b/3.csv", "arms/.hidden/4.csv"):
        place = tmp_path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "5.csv").touch()
    (tmp_path / "arms" / "again").symlink_to(tmp_path / "arms")
    (tmp_path / "arms" / "a" / "up").symlink_to(tmp_path)
    (tmp_path / "arms" / "0_same").symlink_to("b")
    (tmp_path / "arms" / "b" / "lost.csv").symlink_to("nowhere")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(pattern):
    return [str(path) for path in files_of(pattern)]


def test_any_depth_ends_where_links_lead_back(tree):
    assert names("arms/**/*.csv") == [
        "arms/a/1.csv",
        "arms/a/old/2.csv",
        "arms/a/up/store/5.csv",
        "arms/b/3.csv",
        "arms/b/lost.csv",
    ]
    assert names(f"{tree}/arms/**/old/*.csv") == [f"{tree}/arms/a/old/2.csv"]
    assert names("**/old/**/2.csv") == ["arms/a/old/2.csv"]
    assert names("**/3.csv") == ["arms/b/3.csv"]


def test_a_link_that_is_given_is_followed(tree):
    assert names("arms/0_same/*.csv") == ["arms/0_same/3.csv", "arms/0_same/lost.csv"]
    (tree / "arms" / "c").symlink_to(tree / "store")
    (tree / "arms" / "a" / "up").unlink()
    assert names("arms/**/5.csv") == ["arms/c/5.csv"]


@pytest.mark.usefixtures("tree")
def test_folders_and_nothing_are_no_files():
    assert names("none/**") == []
    assert names("arms/*") == []
    assert "arms/b/3.csv" in names("arms/**")
