"""The engine of `slam.mode = "localisation"`: robots know a finished map, and only find their poses in it.

A robot that has not found itself draws a map of its own, to drive by; once it has, the finished map is its map, which
no scan changes. Nothing is sent: all robots have that map from the start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.errors import DataError
from twc_env.records.geometry import compose
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import Contacts, Keyframe, SensorFrame
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.localisation import Localiser, Walls
from twc_env.slam.team import TeamMapper


class LocalisedTeam(TeamMapper):
    """The finished map, and the keyframes of robots, placed in it by localisation alone."""

    def __init__(self, config: EnvConfig, robot_count: int, home: int | None, prior: LastingMap):
        """Raises DataError for a map without walls."""
        super().__init__(config, robot_count, home, prior)
        walls = Walls.of(prior)
        self.localisers = [Localiser(config, walls) for _ in range(robot_count)]

    def update(self, step: int, keyframes: Sequence[Keyframe], scans: Sequence[tuple[int, int]] = ()) -> bool:
        """Place new keyframes; the map of a robot that has found itself becomes the finished one."""
        assert self.prior is not None
        for received in keyframes:
            keyframe, localiser = self._as_segment(received), self.localisers[received.robot]
            group, known = self.group_index(received.robot), self.group_of_segment(self.prior)
            node = self._graph.add_keyframe(keyframe)
            self._maps.add(keyframe, node, is_drawn=group != known)
            if localiser.pose_map_odom is None or (group != known and localiser.is_lost):
                continue
            if group != known:
                self._maps.join_prior(known, group, localiser.pose_map_odom)
            self._graph.place(np.array([node]), compose(localiser.pose_map_odom, received.pose_odom)[None])
            if not localiser.is_lost:
                self._graph.last_closure_node[keyframe.robot] = node
        return len(keyframes) > 0

    def finish(self) -> None:
        """Nothing is queued."""

    def lasting_map(self) -> LastingMap:
        """Raises DataError: the map is the one that was given."""
        raise DataError("slam.mode is 'localisation': the map does not change; there is nothing to save")


class MapLocalisation(CooperativeSlam):
    """The interface of `CooperativeSlam`, in a map that does not change."""

    _mapper_class = LocalisedTeam

    def __init__(self, config: EnvConfig, robot_count: int, prior: LastingMap):
        """prior: a saved map, or a plain grid (`LastingMap.of_grid`). Raises DataError for a map without walls."""
        super().__init__(
            override(config, {"link.topology": "central", "link.scan_on_request": False}), robot_count, prior
        )
        self._new: list[Keyframe] = []
        """Keyframes since the last `absorb`."""

    @property
    def localisers(self) -> list[Localiser]:
        """State of each robot: whether it is lost, and how well its latest scan fits."""
        (team,) = self.mappers
        assert isinstance(team, LocalisedTeam)
        return team.localisers

    def _send(self, keyframes: Sequence[Keyframe]) -> None:
        self._new += keyframes

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Run the front end of each frame's robot, and match its scan to the map."""
        keyframes = super().track(frames)
        if isinstance(frames, TeamFrames):
            times_s = dict.fromkeys(range(len(self.robots)), frames.time_s)
        else:
            times_s = {frame.robot: frame.time_s for frame in frames}
        for robot, time_s in times_s.items():
            own = [keyframe for keyframe in keyframes if keyframe.robot == robot]
            self.localisers[robot].update(self.poses_odom[robot], self._latest_scans[1][robot], own, time_s)
        return keyframes

    def absorb(self, step: int, contacts: Contacts | None = None) -> None:
        """Place new keyframes in the map. Contacts only tell when teammates were heard."""
        self._listening.note(step, (contacts or self._full_contact).heard)
        if self.team.update(step, self._new):
            self._update_robots(0, self.team)
            self._new = []
        for robot, localiser in enumerate(self.localisers):
            if localiser.pose_map_odom is not None and self.found_prior(robot):
                self._poses_map_odom[robot] = localiser.pose_map_odom
        self._update_poses()
        self._update_maps()

    def lacked(self) -> list[str]:
        """One line per robot that is lost now."""
        lines = []
        for robot, own in enumerate(self.localisers):
            if own.is_lost:
                size = own.map_scale
                hint = (
                    "" if size == 1.0 else f"; at {size:.2g} times its size its scans would fit: check its resolution"
                )
                lines.append(f"robot {robot} is lost in the map{hint}")
        return lines
