"""A worker process that dies as it begins is told of, whatever it was sent."""

import operator
import os

import pytest

from limo_driver.runtime.processes import WorkerProcess


class Deadly:
    """Ends the process that reads it."""

    def __reduce__(self):
        return os._exit, (3,)


@pytest.mark.parametrize("work", [operator.methodcaller("recv"), operator.not_])
def test_a_large_job_of_a_process_that_dies_is_not_waited_for(work):
    worker = WorkerProcess(work, (Deadly(), bytes(1 << 20)))
    worker.start("task")
    with pytest.raises((EOFError, ConnectionResetError)):
        worker.connection.recv()
    worker.process.join()
    assert worker.stop() == (0 if work is operator.not_ else 3)
