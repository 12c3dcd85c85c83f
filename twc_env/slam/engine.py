"""The cooperative SLAM engine: sensor frames in, beliefs out. It also runs on recorded frames, without a world."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import ROBOTS_MAX, CuesConfig, EnvConfig, shared_config
from twc_env.config.checks import whole_number
from twc_env.errors import ConfigError, DataError, TwcError
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import Belief, Contacts, Keyframe, SensorFrame
from twc_env.records.team_messages import NOBODY, TeamBeliefs, TeamFrames, nobody
from twc_env.records.whole_copy import CopiedWhole
from twc_env.slam import cues
from twc_env.slam.diagnostics import Listening, diagnostics_of
from twc_env.slam.exchange import Exchange
from twc_env.slam.front_end.frame_check import check_frames
from twc_env.slam.front_end.robot_clocks import RobotClocks
from twc_env.slam.mapping.map_beliefs import HeldMaps, MapBeliefs
from twc_env.slam.pose_graph.systematic_errors import std_with_shared
from twc_env.slam.robot import FrontEnds, RobotFrontEnd
from twc_env.slam.team import TeamMapper
from twc_env.slam.walls.radio_structure import RadioStructure

MATCHED_STD_SHARE = 0.25
"""Actual drift of scan-matched paths as a share of their accumulated standard deviation. The latter is deliberately
conservative because closures are tested against it."""
_INT = np.dtype(np.int64)
"""Of steps."""


@borrowing_kernel
def _believe(held, step, poses_odom, teammates, out, teammate_poses, contact_steps):
    """Write out (robots, 3, 3): pose in the map frame, its standard deviation, pose in the odom frame.

    Also teammate_poses (robots, robots - 1, 3) in the map frame, with one mapper per robot as of the newest keyframe
    received, otherwise current; and contact_steps (robots, robots - 1) as in `TeamBeliefs`.
    """
    poses_map_odom, std, std_share, is_central, received_poses, is_heard, last_steps = parts_of(held)
    for k in range(out.shape[0]):
        c, s = math.cos(poses_map_odom[k, 2]), math.sin(poses_map_odom[k, 2])
        x, y, heading = poses_odom[k, 0], poses_odom[k, 1], poses_odom[k, 2]
        out[k, 0, 0] = poses_map_odom[k, 0] + c * x - s * y
        out[k, 0, 1] = poses_map_odom[k, 1] + s * x + c * y
        out[k, 0, 2] = (poses_map_odom[k, 2] + heading + math.pi) % (2 * math.pi) - math.pi
        for j in range(3):
            out[k, 1, j] = std_share * std[k, j]
        out[k, 2, 0], out[k, 2, 1], out[k, 2, 2] = x, y, heading
    for k in range(teammates.shape[0]):
        for a in range(teammates.shape[1]):
            teammate = max(teammates[k, a], 0)
            for j in range(3):
                teammate_poses[k, a, j] = out[teammate, 0, j] if is_central else received_poses[k, a, j]
            listener, other = 0 if is_central else k, a if a < k else a + 1
            contact_steps[k, a] = step if is_heard[listener, other] else last_steps[listener, other]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One map in use: a group of one mapper, and the robots that use it."""

    mapper: TeamMapper
    group: int
    viewers: tuple[int, ...]
    """With a central mapper, the whole group; otherwise the robot that owns this mapper."""

    @property
    def robots(self) -> tuple[int, ...]:
        """All robots that are in the map."""
        return self.mapper.segments.robots_in(self.segments)

    @property
    def segments(self) -> tuple[int, ...]:
        """All segments of robots whose keyframes the map holds: the robots, unless some were carried (`Segments`)."""
        held, prior = self.mapper.groups[self.group].robots, self.mapper.prior
        return held if prior is None else tuple(segment for segment in held if segment != prior)


class CooperativeSlam(CopiedWhole):
    """One front end per robot, and one central mapper or one per robot (`link.topology`).

    `track` runs the front ends; `absorb` exchanges messages and updates the mappers. `update` does both.
    """

    _mapper_class: ClassVar[Callable[..., TeamMapper]] = TeamMapper

    def __init__(self, config: EnvConfig, robot_count: int, prior: LastingMap | None = None):
        """prior: the map of an earlier session, which `slam.prior` names (`datasets.lasting_maps.read_lasting_map`)."""
        if not isinstance(config, EnvConfig):
            raise ConfigError(
                f"config must be an EnvConfig; got {config!r}: twc_env.config.override makes one of a dict"
            )
        robot_count = whole_number("robot_count", robot_count, 1, ROBOTS_MAX)
        if prior is not None or config.slam.prior:
            _check_prior(config, prior)
        if config.robot and robot_count != config.robots:
            raise ConfigError(f"robot lists {config.robots} robots, and the engine is for {robot_count}: give as many")
        self._cues = None if config.slam.cues == CuesConfig() else config.slam.cues
        """The enabled cues; None: all."""
        config = cues.restricted_config(shared_config(config))
        self._front_ends = FrontEnds(config, robot_count)
        self.poses_odom = self._front_ends.poses_odom
        """(robots, 3) front-end poses, each in the robot's odom frame."""
        self._beam_count = config.lidar.circle_beam_count
        self._is_central = config.link.topology == "central"
        homes = [None] if self._is_central else range(robot_count)
        self.mappers = [self._mapper_class(config, robot_count, home, prior) for home in homes]
        self._exchange = Exchange(config, robot_count)
        self.bytes_sent: dict[str, int] = self._exchange.bytes_sent
        """Message type -> bytes transmitted so far."""
        self._wanted = [mapper.wanted for mapper in self.mappers]
        self._listening = Listening(len(self.mappers), robot_count, config.dynamics.time_step_s)
        everyone = np.ones((len(self.mappers), robot_count), bool)
        if not self._is_central:
            np.fill_diagonal(everyone, False)
        self._full_contact = Contacts(everyone, everyone)
        self._latest_scans: tuple[Sequence[int], Sequence[Array] | Array] = (
            [0] * robot_count, [np.zeros(0)] * robot_count
        )  # fmt: skip
        """Step and scan of the latest frame of each robot."""
        self._clocks = RobotClocks(config, robot_count)
        self._poses = np.zeros((robot_count, 3, 3))
        """As `TeamBeliefs.poses`."""
        self._poses_map_odom = np.zeros((robot_count, 3))
        self._since_closure_m, self._std = np.zeros(robot_count), np.zeros((robot_count, 3))
        """Of each robot: path length since its last closure, and the standard deviation accumulated on it."""
        self._odometry_scale_std = None if config.slam.cues.lidar else config.slam.odometry_filter.odometry_scale_std
        self._teammates, self._teammate_poses, self._contact_steps = nobody(robot_count)
        """As in `TeamBeliefs`."""
        self._shapes = self._poses.shape, self._teammate_poses.shape, self._contact_steps.shape
        self._received_poses = np.zeros_like(self._teammate_poses)
        """With one mapper per robot: poses of the teammates as of the newest keyframe received."""
        self._maps: HeldMaps | None = None
        """Cache of `_look_up_maps`; None: outdated."""
        self._counts = [(-1, -1, -1, -1)] * len(self.mappers)
        """State of each mapper (`TeamMapper.counts`) at the last `_update_robots`."""
        self._views: tuple[list[int], list[View]] = [], []
        """Cache of `views`, valid for these counts of regroupings."""
        self._run: Callable[..., None] | None = None
        """`_believe`, bound to the arrays of odom frames and of contacts."""
        self._beliefs: TeamBeliefs | None = None
        """Cache of `beliefs`; None: outdated."""
        radio = config.slam.k_visibility
        self._radio = RadioStructure(radio, config.slam.resolution_m, robot_count) if radio.enabled else None

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_run": None}

    def give_starts(self, poses: Array) -> None:
        """Give all mappers the true start poses (robots, 3): an oracle, for comparison only (`slam.oracle`)."""
        for mapper in self.mappers:
            mapper.give_starts(poses)

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Give positions (k, 2) of transmitters (k,) and, in that frame, the robots' starts (robots, 3): an oracle.

        See `slam.k_visibility.are_transmitters_known`.
        """
        if self._radio is not None:
            self._radio.give_transmitters(macs, position_m, start_poses)

    @property
    def robots(self) -> list[RobotFrontEnd]:
        """The front end of each robot."""
        return self._front_ends.robots

    @property
    def team(self) -> TeamMapper:
        """The central mapper; with one mapper per robot, that of robot 0."""
        return self.mappers[0]

    def mapper_of(self, robot: int) -> TeamMapper:
        """The mapper whose map this robot uses. Raises TwcError for an unknown robot."""
        self._check_robot(robot)
        return self.mappers[0 if self._is_central else robot]

    def views(self) -> list[View]:
        """All maps in use."""
        regroupings = [mapper.regroupings for mapper in self.mappers]
        if self._views[0] != regroupings:
            if self._is_central:
                robots_in, groups = self.team.segments.robots_in, enumerate(self.team.groups)
                shown = [View(self.team, k, robots_in(group.robots)) for k, group in groups]
                views = [view for view in shown if view.viewers]  # no robot uses the map of an earlier segment
            else:
                views = [View(mapper, mapper.group_index(r), (r,)) for r, mapper in enumerate(self.mappers)]
            self._views = regroupings, views
        return self._views[1]

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Run the front end of each frame's robot; returns the new keyframes, in order, ready to be sent.

        Raises DataError for invalid frames.
        """
        self._beliefs = None
        if isinstance(frames, TeamFrames) and self._clocks.differ:
            frames = list(frames)
        if not isinstance(frames, TeamFrames):
            check_frames(frames, self._clocks.times_s, self._beam_count)
            frames = [self._clocks.corrected(frame, self._is_first(frame.robot)) for frame in frames]
        if self._cues is not None:
            frames = [cues.restricted_frame(frame, self._cues) for frame in frames]
        frames, circles = self._front_ends.intake.on_circle(frames)
        if isinstance(frames, TeamFrames):
            self._latest_scans = [frames.step] * len(frames.signs), circles
        else:
            steps, ranges_m = map(list, self._latest_scans)  # copies: earlier beliefs refer to the old lists
            for frame, circle in zip(frames, circles, strict=True):
                steps[frame.robot], ranges_m[frame.robot] = frame.step, circle
            self._latest_scans = steps, ranges_m
        keyframes = self._front_ends.update(frames, self._listening.last_step + 1)
        self.poses_odom = self._front_ends.poses_odom
        if self._radio is not None:
            for frame in frames:
                self._radio.add(frame, self.poses_odom[frame.robot])
        self._send(keyframes)
        return keyframes

    def _send(self, keyframes: Sequence[Keyframe]) -> None:
        for keyframe in keyframes:
            self._exchange.add(keyframe)

    def _is_first(self, robot: int) -> bool:
        """Whether no frame of this robot has come in yet."""
        return len(self._latest_scans[1][robot]) == 0 and self._clocks.times_s[robot] == -math.inf

    def absorb(self, step: int, contacts: Contacts | None = None) -> None:
        """Exchange messages as the contacts of this step allow (None: all are in contact) and update the mappers.

        Raises DataError for contacts of another kind.
        """
        if contacts is not None and not isinstance(contacts, Contacts):
            raise DataError(f"contacts must be a Contacts, or None for all robots; got {contacts!r:.100}")
        contacts = contacts or self._full_contact
        self._listening.note(step, contacts.heard)
        deliveries = self._exchange.deliver(contacts, self._wanted)
        for number, mapper in enumerate(self.mappers):
            delivery = deliveries[number]
            if mapper.update(step, delivery.keyframes, delivery.scans):
                self._update_robots(number, mapper)
            if delivery.scans:
                self._maps = None
        self._update_poses()
        self._update_maps()

    def _update_poses(self) -> None:
        """Compute the poses in the map frames from the current front-end poses, and the steps of the last contacts."""
        poses, teammates, pairs = self._shapes
        self._poses, self._teammate_poses = np.empty(poses), np.empty(teammates)
        self._contact_steps = np.empty(pairs, _INT)
        self._beliefs, listening = None, self._listening
        now = (
            listening.last_step, self.poses_odom, self._teammates, self._poses, self._teammate_poses,
            self._contact_steps,
        )  # fmt: skip
        if self._run is None:
            std_share = MATCHED_STD_SHARE if self._odometry_scale_std is None else 1.0
            held = (
                self._poses_map_odom, self._std, std_share, self._is_central, self._received_poses,
                listening.is_heard, listening.last_steps,
            )  # fmt: skip
            self._run = bound(_believe, Lent(held), *now)
        self._run(*now)

    def _update_robots(self, number: int, mapper: TeamMapper) -> None:
        """Update odom frames, drift and teammates if the mapper has changed; earlier beliefs keep their arrays."""
        counts, before = mapper.counts(), self._counts[number]
        if counts == before:
            return
        self._counts[number] = counts
        since_m = self._since_closure_m.copy()
        everyone = self._front_ends.everyone
        robots = everyone if self._is_central else everyone[number : number + 1]
        mapper.locate(robots, (self._poses_map_odom, self._std, since_m))
        if self._odometry_scale_std is not None:
            self._std[robots] = std_with_shared(self._std[robots], since_m[robots], self._odometry_scale_std)
        if counts[1] != before[1] or not self._is_central:
            self._update_teammates(robots.tolist(), mapper)
        if counts[2:] != before[2:]:
            self._maps = None
        self._since_closure_m = since_m

    def _update_teammates(self, robots: Sequence[int], mapper: TeamMapper) -> None:
        """Update the teammates of these robots."""
        teammates = self._teammates.copy()
        for robot in robots:
            robots_in = mapper.segments.robots_in(mapper.groups[mapper.group_index(robot)].robots)
            others = [teammate for teammate in robots_in if teammate != robot]
            teammates[robot] = others + [NOBODY] * (teammates.shape[1] - len(others))
            if not self._is_central:
                for k, teammate in enumerate(others):
                    self._received_poses[robot, k] = mapper.latest_pose_of(teammate)
        self._teammates = teammates

    def finish(self) -> None:
        """Process everything queued in the mappers (end of an episode or log); nothing more is sent."""
        for number, mapper in enumerate(self.mappers):
            mapper.finish()
            mapper.update(self._listening.last_step, [])
            self._update_robots(number, mapper)
        self._update_poses()
        self._update_maps()

    def update(self, frames: Sequence[SensorFrame], contacts: Contacts | None = None) -> None:
        """`track` and `absorb` in one call.

        A step of the team ends when a robot gives its next frame, so each robot may number its frames independently.
        After steps by `track` and `absorb`, as in an episode, it goes on from the last of them.
        """
        self.track(frames)
        given = self._clocks.given
        if self._listening.has_begun:
            given += max(0, self._listening.last_step + 1 - int(given.max()))
        given[self._front_ends.everyone if isinstance(frames, TeamFrames) else [frame.robot for frame in frames]] += 1
        self.absorb(max(self._listening.last_step, int(given.max()) - 1), contacts)

    def lasting_map(self) -> LastingMap:
        """The map so far, for a later session to begin with: with a prior map the two as one, or the prior map itself
        if no robot has found it. With one mapper per robot, that of robot 0.

        Raises DataError without keyframes.
        """
        return self.team.lasting_map()

    @property
    def unsaved_robots(self) -> tuple[int, ...]:
        """Robots whose present map is not the one that `lasting_map` gives."""
        return self.team.unsaved_robots

    def found_prior(self, robot: int) -> bool:
        """Whether the robot's map is merged with that of an earlier session."""
        mapper = self.mapper_of(robot)
        return mapper.prior is not None and mapper.group_index(robot) == mapper.group_of_segment(mapper.prior)

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) estimate of a robot in its group's map frame, as of the last `absorb`. Raises TwcError for an unknown
        robot."""
        self._check_robot(robot)
        return self._poses[robot, 0]

    def lacked(self) -> list[str]:
        """Missing or misleading input so far, one line each; with one mapper per robot, for each of them."""
        lines = []
        for number, mapper in enumerate(self.mappers):
            others = [r for r in range(len(self.robots)) if self._is_central or r != number]
            own = self._listening.lines(number, others) + diagnostics_of(mapper)
            lines += own if self._is_central else [f"mapper of robot {number}: {line}" for line in own]
        return lines

    def belief(self, robot: int) -> Belief:
        """Current belief of one robot. Raises TwcError for an unknown robot."""
        self._check_robot(robot)
        belief, mapper = self.beliefs()[robot], self.mapper_of(robot)
        if len(mapper.groups) == 1:
            return belief
        group = mapper.group_index(robot)
        hypotheses, trails = mapper.hypotheses_of(group), mapper.radio_trails_of(group)
        return dataclasses.replace(belief, hypotheses=hypotheses, radio_trails=trails)

    def _check_robot(self, robot: int) -> None:
        if not (isinstance(robot, (int, np.integer)) and 0 <= robot < len(self.robots)):
            raise TwcError(f"robots are 0 to {len(self.robots) - 1}; got {robot!r}")

    def beliefs(self) -> TeamBeliefs:
        """Current beliefs of all robots."""
        if self._beliefs is None:
            if self._maps is None:
                self._maps = self._look_up_maps()
            self._beliefs = MapBeliefs(
                self._poses, self._since_closure_m, self._maps, self._teammates, self._teammate_poses,
                self._contact_steps, *self._latest_scans,
            )  # fmt: skip
        return self._beliefs

    def _update_maps(self) -> None:
        """Look up what has changed of signs and radio maps, which are cumulative: in every step, so that they do not
        depend on when beliefs are asked for."""
        if self._maps is None or self._radio is not None:
            self._maps = self._look_up_maps()

    def _look_up_maps(self) -> HeldMaps:
        """Grid, signs, version and radio map of each robot."""
        rows: list[Any] = [None] * len(self.robots)
        for view in self.views():
            mapper, number = view.mapper, view.group
            group = mapper.groups[number]
            grid, signs = group.grid.snapshot(), mapper.signs_of(number)
            picture = None
            if self._radio is not None:  # from the readings of the viewers: with one mapper per robot, its own only
                poses = np.array([mapper.pose_map_odom(robot) for robot in view.viewers])
                picture = self._radio.picture_of(view.viewers, poses, group.version)
            for robot in view.viewers:
                rows[robot] = grid, signs, group.version, picture
        grids, signs_of, versions, pictures = map(list, zip(*rows, strict=True))
        return grids, signs_of, versions, pictures


def _check_prior(config: EnvConfig, prior: LastingMap | None) -> None:
    """Raise ConfigError for a prior map that this engine cannot begin with."""
    slam, lidar = config.slam, config.lidar
    if prior is not None and not isinstance(prior, LastingMap):
        raise ConfigError(f"prior must be a map as datasets.lasting_maps.read_lasting_map gives; got {prior!r:.100}")
    if prior is None:
        raise ConfigError(
            f"slam.prior is {slam.prior!r}: give its content, prior=datasets.lasting_maps.read_lasting_map(FILE)"
        )
    reasons = {
        "slam.oracle": slam.oracle != "none" and f"is {slam.oracle!r}: known starts are in another frame",
        "slam.radio_slam.online": slam.radio_slam.online and "is on: radio constraints know no earlier paths",
        "slam.cues.lidar": not slam.cues.lidar and "is off: without scan matching nothing holds the two together",
    }
    for name, reason in reasons.items():
        if reason:
            raise ConfigError(f"{name} {reason}; use the default, or no slam.prior")
    beams = prior.scans_m.shape[1]
    if (beams, prior.range_max_m) != (lidar.circle_beam_count, float(lidar.range_max_m)):
        raise ConfigError(
            f"slam.prior was made with {beams} beams of up to {prior.range_max_m:g} m, this scanner has "
            f"{lidar.circle_beam_count} of up to {lidar.range_max_m:g} m: set lidar.beam_count and lidar.range_max_m"
        )
