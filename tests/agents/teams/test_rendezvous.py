"""Meetings of robots that share a map, in a corridor that is open at both ends."""

from dataclasses import replace

from twc_env.agents.slam_aware.rendezvous import Rendezvous

from twc_env.config import EnvConfig, override
from twc_env.records.messages import Belief

from .test_frontier_teams import believed

PEERS = override(EnvConfig(), {"link.topology": "peer", "robots": 3})


def at_step(step: int, heard: dict[int, list[int]], *x_m: float) -> dict[str, Belief]:
    """Beliefs at a step, in which each robot hears some others."""
    found = {}
    for agent, belief in believed(*x_m).items():
        contacts = {other: step if other in heard[belief.robot] else 0 for other in belief.teammates}
        found[agent] = replace(belief, step=step, pose_odom=belief.pose_map_robot, contact_steps=contacts)
    return found


def test_an_appointment_is_not_changed_behind_the_back_of_who_is_away():
    """Two robots stay together, the third is out of contact: all three keep what they agreed on."""
    team = Rendezvous(PEERS)
    team.reset(0, [f"robot_{k}" for k in range(3)])
    together, apart = {0: [1, 2], 1: [0, 2], 2: [0, 1]}, {0: [1], 1: [0], 2: []}
    team.act(at_step(0, together, 9.0, 10.0, 11.0))
    team.act(at_step(40, together, 10.0, 11.0, 12.0))
    agreed = team._appointments["robot_0"].step
    team.act(at_step(80, apart, 16.0, 17.0, 6.0))
    assert agreed == 40
    assert team._appointments["robot_0"].step == agreed
