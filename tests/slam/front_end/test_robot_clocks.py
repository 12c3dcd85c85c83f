from dataclasses import replace

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.records.geometry import compose
from twc_env.records.messages import SensorFrame
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.front_end.robot_clocks import RobotClocks

JUMPS_S = [0.5, 2.0, 10.0, 3600.0, 1e6]


def travelled(steps, count=3):
    engine = CooperativeSlam(EnvConfig(), count)
    for frames in steps:
        engine.track(frames)
    return engine.poses_odom


def turning_step(steps) -> int:
    """A step at which robot 1 turns fast."""
    return max(range(50, 150), key=lambda step: abs(steps[step][1].turn_rate_rad_s))


@pytest.mark.parametrize("jump_s", JUMPS_S)
def test_a_jump_of_a_clock_does_not_change_the_path(recorded, jump_s):
    _, steps, _ = recorded
    at = turning_step(steps)
    jumped = [[replace(f, time_s=f.time_s + jump_s * (f.robot == 1 and f.step >= at)) for f in step] for step in steps]
    assert np.allclose(travelled(jumped[:300]), travelled(steps[:300]), atol=0.02)


@pytest.mark.parametrize("pause_s", [3600.0, 1e6, 1.7e9])
def test_a_robot_without_gyro_keeps_its_heading_while_it_stands_for_long(recorded, pause_s):
    """Its turn rates are computed from odometry, so that they never contradict it."""
    _, steps, _ = recorded
    at, own, paused = 150, [], []
    for frames in steps[:300]:
        frame = replace(frames[1], turn_rate_rad_s=frames[1].odometry[2] / 0.1)
        if frame.step == at:  # it stood still until then
            frame = replace(frame, odometry=np.zeros(3), turn_rate_rad_s=0.0, ranges_m=own[-1][0].ranges_m)
        own.append([frame])
        paused.append([replace(frame, time_s=frame.time_s + pause_s * (frame.step >= at))])
    assert np.allclose(travelled(paused)[1], travelled(own)[1], atol=0.02)


@pytest.mark.parametrize("lost", [6, 8, 16])
def test_a_gyro_sampled_after_lost_frames_does_not_turn_the_robot(recorded, lost):
    """Odometry accumulates while frames are lost; the gyro gives only the present turn rate."""
    _, steps, _ = recorded
    at = turning_step(steps)
    moved, kept = np.zeros(3), [list(frames) for frames in steps[:300]]
    for step in range(at - lost, at + 1):
        moved = compose(moved, steps[step][1].odometry)
        kept[step].pop(1)
    kept[at].append(replace(steps[at][1], odometry=moved))
    assert np.allclose(travelled(kept), travelled(steps[:300]), atol=0.03)


def test_frame_numbers_of_robots_do_not_change_the_map(recorded):
    """Frames arrive one by one; the frames of the robot whose numbers are far ahead end early."""
    config, steps, _ = recorded
    engines = [CooperativeSlam(config, 3) for _ in range(2)]
    for frames in steps:
        for each in frames:
            if each.robot != 1 or each.step < 250:
                engines[0].update([each])
                engines[1].update([replace(each, step=each.step + (0, 100_000, 7)[each.robot])])
    for robot in range(3):
        poses = [engine.pose_map_robot(robot) for engine in engines]
        assert poses[0].tobytes() == poses[1].tobytes()
    assert engines[0].lacked() == engines[1].lacked()


def frame(time_s, turned_rad=0.0, turn_rate_rad_s=0.0) -> SensorFrame:
    return SensorFrame(0, 0, time_s, np.array([0.0, 0.0, turned_rad]), turn_rate_rad_s, np.full(4, 3.0))


def test_a_gap_that_agrees_with_the_gyro_is_real_time():
    clocks = RobotClocks(EnvConfig(), 1)
    given = [frame(5.0), frame(5.1, 0.1, 1.0), frame(7.1, 2.0, 1.0)]
    told = [clocks.corrected(each, k == 0) for k, each in enumerate(given)]
    assert [each.time_s for each in told] == pytest.approx([0.0, 0.1, 2.1])
    assert [each.turn_rate_rad_s for each in told] == [0.0, 1.0, 1.0]


def test_a_gap_that_contradicts_the_gyro_counts_as_one_step_with_the_turn_of_the_odometry():
    clocks = RobotClocks(EnvConfig(), 1)
    given = [frame(5.0), frame(5.2, 0.1, 0.5), frame(3605.2, 0.3, 0.5), frame(3605.4, 0.1, 0.5)]
    told = [clocks.corrected(each, k == 0) for k, each in enumerate(given)]
    assert [each.time_s for each in told] == pytest.approx([0.0, 0.2, 0.4, 0.6])
    assert [each.turn_rate_rad_s for each in told] == pytest.approx([0.0, 0.5, 1.5, 0.5])


def test_a_stream_with_another_frame_rate_has_no_gaps():
    clocks = RobotClocks(EnvConfig(), 1)
    given = [frame(float(k), 0.5, 0.5) for k in range(5)]
    assert [clocks.corrected(each, k == 0) for k, each in enumerate(given)] == given
