"""The block `signs`, recomputed from frames and beliefs."""

import numpy as np
import pytest

import twc_env
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.slam.places.sign_readings import SAME_SIGN_M

SLOTS, MEMORY_S = 4, 5.0


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_the_fifth_column_counts_the_other_places_of_a_text_at_every_step(topology):
    """Also before the keyframe of a reading has been received, which an outage of the link delays."""
    config = {"building.sign_duplication": 1.0, "link.topology": topology, "action.kind": "frontier"}
    config |= {"action.decision_max_s": 0.1, "failure.link_begin_step": 60, "failure.link_end_step": 90}
    env = twc_env.parallel_env(map="gen:office:300:1", robots=2, max_cycles=150, config=config)
    observations, _ = env.reset(seed=1)
    readings = {agent: [] for agent in env.possible_agents}  # text, time, place in the odom frame; newest first
    counts, unmapped = set(), 0
    while env.agents:
        time_s = env.frames[0].time_s
        for frame, agent in zip(env.frames, env.possible_agents, strict=True):
            belief = env.belief(agent)
            for sign in frame.signs:
                angle = belief.pose_odom[2] + sign.bearing_rad
                place = belief.pose_odom[:2] + sign.range_m * np.array([np.cos(angle), np.sin(angle)])
                readings[agent].insert(0, (sign.text, time_s, place))
            odom_in_map = compose(belief.pose_map_robot, inverse(belief.pose_odom))
            for (text, since_s, place), row in zip(readings[agent][:SLOTS], observations[agent]["signs"], strict=False):
                if time_s - since_s > MEMORY_S + 1e-9:
                    break
                known = np.array([sign.position_m for sign in belief.signs if sign.text == text]).reshape(-1, 2)
                away_m = np.hypot(*(known - transform_points(odom_in_map, place[None])).T)
                is_mapped = bool((away_m < SAME_SIGN_M).any())
                others = len(known) - is_mapped
                assert 2.0 * row[4] / (1.0 - row[4]) == pytest.approx(others, abs=1e-4)
                unmapped += others > 0 and not is_mapped
                counts.add(others)
        choices = {agent: int(observations[agent]["action_mask"].argmax()) for agent in env.agents}
        observations, *_ = env.step(choices)
    assert 0 in counts and unmapped
