"""What tests of commands and of the network share."""

import pytest
from sessions import sessions_of_two


@pytest.fixture
def two_sessions(tmp_path):
    """Two sessions that see each other and nobody else."""
    with sessions_of_two(tmp_path) as both:
        yield both


@pytest.fixture
def run(limo, monkeypatch, tmp_path):
    """Run a limo command in a folder of its own: its status, and what it says to whom."""
    monkeypatch.chdir(tmp_path)

    def of(*arguments):
        ended = limo(*arguments)
        return ended.returncode, ended.stdout, ended.stderr

    return of
