"""What bounds the learned part of an estimate."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.service.settings import ServiceSettings
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel

LIMITS = RobotModel.load("iiwa14").limits


def test_the_bound_is_a_tenth_of_the_torque_limit_or_what_is_given():
    np.testing.assert_allclose(ServiceSettings().bounds(LIMITS), LIMITS.torque / 10)
    np.testing.assert_array_equal(ServiceSettings(bound=3.0).bounds(LIMITS), np.full(7, 3.0))


@pytest.mark.parametrize("nothing", [np.inf, 0.0, np.nan])
def test_nothing_is_bounded_by_a_limit_that_is_not_stated(nothing):
    torque = np.where(np.isin(np.arange(7), (1, 6)), nothing, LIMITS.torque)
    limits = replace(LIMITS, torque=torque)
    with pytest.raises(ConfigError, match=r"no torque limit is stated of joint 2, 7, .*`bound`"):
        ServiceSettings().bounds(limits)
    np.testing.assert_array_equal(ServiceSettings(bound=3.0).bounds(limits), np.full(7, 3.0))
