"""What tests of the network share."""

import pytest
from sessions import sessions_of_two


@pytest.fixture
def two_sessions(tmp_path):
    """Two sessions that see each other and nobody else."""
    with sessions_of_two(tmp_path) as both:
        yield both
