"""Two logs of one building by unlike scanners: half the field of view, half the rate."""

import dataclasses
import math

import numpy as np
import pytest

from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.sample import sample_files
from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.replaying.inputs import Asked, input_of
from twc_env.replaying.run import run

FILES = sample_files()
READINGS = Asked(wifi=FILES.wifi, signs=FILES.signs)


def ahead(log: ScanLog) -> ScanLog:
    """Without the rear half of each scan."""
    angles = np.remainder(log.beam_angles_rad + math.pi, 2 * math.pi) - math.pi
    kept = np.flatnonzero(np.abs(angles) <= math.pi / 2 + 1e-6)
    order = kept[np.argsort(angles[kept])]
    return dataclasses.replace(log, ranges_m=log.ranges_m[:, order], beam_angles_rad=angles[order])


def rare(log: ScanLog) -> ScanLog:
    """Every second scan."""
    return dataclasses.replace(log, times_s=log.times_s[::2], poses=log.poses[::2], ranges_m=log.ranges_m[::2])


@pytest.mark.parametrize(("change", "asked"), [(ahead, READINGS), (ahead, Asked()), (rare, Asked())])
def test_scanners_of_unlike_fields_and_rates_share_a_map_or_it_is_said_why(change, asked):
    first, second = map(read_any_log, FILES.logs)
    source = input_of([first, change(second)], [np.zeros(3)] * 2, asked)
    engine = run(source, source.config).engine
    lacked, groups = engine.lacked(), [set(group.robots) for group in engine.team.groups]
    together = any({0, 1} <= group for group in groups)
    assert together or lacked
    if change is rare or asked.wifi:
        assert together, lacked


def test_walls_go_on_between_the_beams_of_a_scanner_of_fewer_directions():
    """Every second direction of the engine had no wall, so that no scan matched, as in the map of a finer scanner."""
    log = read_any_log(FILES.logs[0]).at(slice(0, 60))
    source = input_of([log], [np.zeros(3)], Asked(beam_count=360))
    (path,) = run(source, source.config).paths()
    times_s, true = read_tum(FILES.logs[0].with_name("truth_0.tum"))
    at = np.searchsorted(times_s, path.times_s - 0.05)
    assert absolute_trajectory_error_m(path.estimated, true[at]) < 0.01
