"""What was found of drives is said in the words of those who use them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from estimators.drives.fitting.constants import with_values
from estimators.drives.judgement.wording import plays
from estimators.drives.simulation.plant import rows_of
from limo_driver.physics import Simulation
from limo_driver.physics.drives import PositionServo


def test_play_is_told_in_degrees_where_there_is_some(arm):
    servos = tuple(PositionServo(joint=j, kp=20.0, kd=0.5) for j in (1, 2))
    rigid, loose = rows_of(Simulation(str(arm), drives=servos))
    loose = with_values(np.array(loose), {"play": 0.0157})
    fits = [SimpleNamespace(row=np.array(rigid)), SimpleNamespace(row=loose)]
    assert plays(fits) == ("Joint 2 has 0.9 deg (0.0157 rad) of play between motor and joint.",)
