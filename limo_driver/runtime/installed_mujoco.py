"""MuJoCo as it is installed: one of those that limo works with, or one line on how to get it.

Release 4.0 moved MuJoCo's library into another package, `mujoco-core`. pip installs that one first,
and then removes its files as those of the old `mujoco` in the same folder; nothing but installing
them again helps.
"""

from __future__ import annotations

from typing import Final

from limo_driver.errors import ConfigError

OLDEST: Final = (3, 12)
PLASTIC: Final = 4  # release that has plastic springs
RELEASES: Final = (3, PLASTIC)
_AGAIN: Final = (
    "pip install --force-reinstall --no-deps mujoco mujoco-core mujoco-studio, as pip leaves an "
    "upgrade from MuJoCo 3 to 4 without its library"
)

try:
    import mujoco

    VERSION: Final = str(mujoco.__version__)
except (ImportError, AttributeError) as error:  # a folder without its library has no version
    reason = str(error).partition(". ")[0].splitlines()[0]
    raise ConfigError(f"MuJoCo cannot be imported ({reason}); {_AGAIN}") from error

RELEASE: Final = tuple(int(part) for part in VERSION.split(".")[:2])
if RELEASE < OLDEST:
    raise ConfigError(
        f"MuJoCo {VERSION} is installed, expected {'.'.join(map(str, OLDEST))} or newer: "
        "pip install -U mujoco"
    )

__all__ = ["OLDEST", "PLASTIC", "RELEASE", "RELEASES", "VERSION", "mujoco"]
