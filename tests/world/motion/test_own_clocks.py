"""The clocks of the robots: any offset, and a rate of their own."""

import numpy as np
import pytest

from twc_env.config import FailureConfig
from twc_env.records.messages import SensorFrame
from twc_env.world.motion.failures import OwnClocks


def test_times_have_an_offset_and_a_rate_for_each_robot():
    clocks = OwnClocks(FailureConfig(clock_offset_std_s=100.0, clock_skew_std_ppm=1000.0), 2, 0)
    frames = [SensorFrame(robot, 10 * k, float(k), np.zeros(3), 0.5, np.zeros(0)) for k in (0, 1) for robot in (0, 1)]
    first, other, first_later, other_later = clocks.timed(frames)
    assert first.time_s != other.time_s and abs(first.time_s) > 1.0
    rates = first_later.time_s - first.time_s, other_later.time_s - other.time_s
    assert all(rate != 1.0 and rate == pytest.approx(1.0, abs=0.01) for rate in rates) and rates[0] != rates[1]
    assert first.turn_rate_rad_s == pytest.approx(0.5 / rates[0])
    assert OwnClocks(FailureConfig(), 2, 0).are_one
