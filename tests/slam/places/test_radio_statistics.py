import math

import numpy as np
import pytest

from twc_env.records.messages import Fingerprint
from twc_env.slam.places.radio_statistics import RadioStatistics, radio_difference_db


def test_the_radio_difference_has_a_closed_form_and_ignores_a_common_offset():
    a = Fingerprint(np.array([1, 2]), np.array([-40.0, -50.0]))
    b = Fingerprint(np.array([1, 2]), np.array([-46.0, -52.0]))
    assert radio_difference_db(a, b) == pytest.approx(2.0)
    louder = Fingerprint(a.macs, a.rssi_dbm + 10.0)
    assert radio_difference_db(louder, b) == pytest.approx(2.0)


def test_a_transmitter_missing_on_one_side_counts_as_weak():
    a = Fingerprint(np.array([1, 2]), np.array([-40.0, -50.0]))
    b = Fingerprint(np.array([1]), np.array([-40.0]))
    assert radio_difference_db(a, b) == pytest.approx(20.0)  # differences 0 and 40
    assert radio_difference_db(a, b) == radio_difference_db(b, a)
    assert math.isnan(radio_difference_db(a, Fingerprint(np.zeros(0, int), np.zeros(0))))


def test_one_transmitter_alone_gives_no_difference_because_of_device_offsets():
    near, far = (Fingerprint(np.array([1]), np.array([level])) for level in (-40.0, -80.0))
    assert math.isnan(radio_difference_db(near, far)) and math.isnan(radio_difference_db(near, near))
    other = Fingerprint(np.array([2]), np.array([-80.0]))
    assert radio_difference_db(near, other) == pytest.approx(30.0)  # differences 50 and -10


def test_the_log_ratio_falls_with_the_difference_and_changes_sign_between_the_learned_means():
    statistics = RadioStatistics()
    random = np.random.default_rng(0)
    for _ in range(300):
        statistics.learn(float(random.lognormal(np.log(3.0), 0.3)), True)
        statistics.learn(float(random.lognormal(np.log(12.0), 0.3)), False)
    ratios = [statistics.log_ratio(d) for d in (2.0, 4.0, 6.0, 9.0, 15.0)]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[1] > 1 > -1 > ratios[3]
    assert statistics.log_ratio(6.0) == pytest.approx(0.0, abs=0.6)
    assert statistics.log_ratio(math.nan) == 0.0
