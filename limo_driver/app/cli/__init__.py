"""The `limo` command: one file of this folder is one command, found by its name.

A command's module defines `command`, a typer function whose docstring is its help, or a folder of
such functions defines `command`, a typer group; anything heavy is imported inside the functions, so
that `limo --help` stays fast.
"""

from __future__ import annotations

import os
import sys

from limo_driver.app.console.stopping import Stopping

NOT_READY = 1
USAGE_ERROR = 2
INTERRUPTED = 130


def main() -> None:
    """Run the command line; bad input and Ctrl-C end with one clear line, status 2 and 130.

    Where a service was waited for in vain, the status is 1.
    """
    # No command draws with MuJoCo. Its import would load a window library, which takes long and
    # prints a traceback of its own when it is interrupted.
    os.environ.setdefault("MUJOCO_GL", "disable")
    with Stopping(INTERRUPTED):
        from limo_driver.app.console.command_line import command_line, compilation_line, in_options
        from limo_driver.errors import LimoError, ServiceNotReadyError
        from limo_driver.runtime.plugins import require_own_packages

        # A program that reads figures from stdout need not read about compilation.
        silent = "--json" in sys.argv and not sys.stderr.isatty()
        try:
            require_own_packages()
            line = command_line()
            with compilation_line(silent=silent):
                line(prog_name="limo")  # `python -c` would call it -c
        except LimoError as error:
            sys.stderr.write(f"limo: {in_options(str(error))}\n")
            sys.exit(NOT_READY if isinstance(error, ServiceNotReadyError) else USAGE_ERROR)
        except OSError as error:
            from limo_driver.runtime.outputs import disk_is_full, reason

            if not disk_is_full(error):
                raise
            where = "" if error.filename is None else f"{error.filename}: "
            sys.stderr.write(f"limo: {where}cannot be written: {reason(error)}\n")
            sys.exit(USAGE_ERROR)
