"""Whether commands stand at the rows from which on they act: fits that may look ahead tell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.drives.fitting.identification import typical_start
from estimators.drives.fitting.joint import errors, fit_joint, value_in, with_values
from estimators.drives.simulation.loads import ArmChange, ArmLoads
from estimators.drives.simulation.plant import rows_of
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

_MOVES: Final = 0.05  # [rad], range of a joint that can be judged
_GLANCE: Final = 8  # evaluations
_FARTHEST: Final = 0.5  # [s] of looking ahead
_BETTER: Final = 0.9  # of the error, which looking ahead has to get below
_NONE: Final = 1e-3  # [s], a delay that is none


def check_timing(simulation: Simulation, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Refuse commands that come later than what they cause; tell where all delay is missing.

    A servo lags by its delay and by damping over gain. Where a fit takes no delay, and gets better
    as it looks ahead, no servo has made the motion from these rows.

    Args:
        simulation: With a position servo for each joint.
        recordings: With commands.

    Returns:
        A sentence, if no joint has a delay although one is stated.

    Raises:
        RecordingError: Joints follow commands of later rows.
    """
    stated, first = rows_of(simulation), recordings[0]
    loads = ArmLoads(simulation.body, [first])
    parts = loads.parts(ArmChange.none(loads.n))
    period = 1.0 / first.rate
    ahead = -period * np.arange(round(_FARTHEST / period) + 1)
    leads, gains, delays = list[float](), list[float](), list[float]()
    for j in np.flatnonzero(np.ptp(first.position, axis=0) > _MOVES).tolist():
        fit = fit_joint(parts[j], typical_start(stated[j]), evaluations=_GLANCE)
        delays.append(fit.value("delay"))
        if delays[-1] > _NONE:
            leads.append(0.0)
            gains.append(1.0)
            continue
        scores = [
            float(np.abs(errors(parts[j], with_values(fit.row, {"delay": delay}))).mean())
            for delay in ahead.tolist()
        ]
        best = int(np.argmin(scores))
        leads.append(-float(ahead[best]))
        gains.append(scores[best] / max(fit.mean_error, 1e-9))
    if leads and np.median(leads) > 0.0 and np.median(gains) < _BETTER:
        raise RecordingError(
            f"commands come {float(np.median(leads)):.3g} s or more later than the positions that "
            "follow them; expected the set-point in force at each row",
            path=first.source or None,
        )
    believed = float(np.median([value_in(row, "delay") for row in stated]))
    if delays and max(delays) <= _NONE < believed:
        return (
            f"No joint has a delay, although {believed:.3g} s are stated: commands may be recorded "
            "later than they came into force, and damping found here is then too small.",
        )
    return ()
