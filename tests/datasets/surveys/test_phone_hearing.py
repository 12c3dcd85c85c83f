import numpy as np
import pytest

from twc_env.datasets.surveys.phone_hearing import SWEEP_S, fingerprints


def row(list_s: float, name: str, rssi: float, heard_s: float, mhz: int = 2412) -> list[str]:
    return [f"{1000 * list_s:.0f}", "TYPE_WIFI", "", name, f"{rssi}", f"{mhz}", f"{1000 * heard_s:.0f}"]


def test_names_of_one_radio_count_as_one_and_its_bands_as_two():
    names = [("06:74:9c:2e:9e:f2", 2412), ("0a:74:9c:2e:9e:f2", 2412), ("06:74:9c:2e:9e:f3", 5825)]
    _, (print_,) = fingerprints([row(10, name, -50 - 4 * k, 9, mhz) for k, (name, mhz) in enumerate(names)])
    assert print_.rssi_dbm.tolist() == pytest.approx([-52.0, -58.0])


def test_a_reading_counts_when_it_was_heard_not_when_it_was_listed():
    lists = [2.0 * k + SWEEP_S / 2 for k in range(11)]
    rows = [row(at, "02:00:00:00:00:10", -60, at - 1) for at in lists]
    rows += [row(at, "02:00:00:00:00:20", -40, 4.0) for at in lists if at > 4]  # kept in the phone's memory
    at_s, prints = fingerprints(rows)
    assert at_s.tolist() == pytest.approx(np.arange(0.0, 21.0, 2.0))
    assert [len(p.macs) for p in prints] == [1, 2, 2, 2] + [1] * 7


def test_readings_near_in_time_are_averaged_and_nearer_ones_weigh_more():
    rows = [row(at + SWEEP_S / 2, "02:00:00:00:00:10", rssi, at) for at, rssi in ((0, -60), (2, -50), (4, -40))]
    levels = [p.rssi_dbm[0] for p in fingerprints(rows)[1]]
    assert levels[1] == pytest.approx(-50.0) and -60 < levels[0] < -55 and -45 < levels[2] < -40


def test_a_name_that_is_no_address_is_refused():
    with pytest.raises(ValueError, match="six bytes"):
        fingerprints([row(10, "02:00:00:00:00:01:02:03", -50, 9)])
