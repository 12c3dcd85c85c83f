"""The engine on the frames of a log, and the robots' paths afterwards."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.datasets.lasting_maps import prior_of
from twc_env.records.geometry import between, compose, inverse, travelled_m
from twc_env.replaying.inputs import ReplayInput
from twc_env.running.terminal import Bar
from twc_env.slam.map_localisation import MapLocalisation
from twc_env.slam.mapping.segments import NO_ROBOT
from twc_env.slam.modes import Engine, make_engine
from twc_env.slam.team import TeamMapper


@dataclass(slots=True)
class RobotPath:
    """One robot's path at the times of its frames."""

    robot: int
    name: str
    times_s: Array
    """(frames,) on the clock of the log."""
    estimated: Array
    """(frames, 3) poses of the robot in the map of its group."""
    odometry: Array
    """(frames, 3) poses by the log's odometry, from the start."""
    logged: Array
    """(frames, 3) the same in the frame of the log."""
    part: Array
    """(frames,) number of the part of the path, from 0: a new one begins where the robot was carried away."""
    group: Array
    """(frames,) number of the group of robots in whose map the pose is; -1 while it was lost in a finished map, and
    where a robot without a central mapper holds the pose in a map that is not its last."""
    group_at_end: int
    """Number of the group whose map the robot has at the end."""

    @property
    def length_m(self) -> float:
        """Of all parts, without the ways along which it was carried."""
        parts = [self.estimated[self.part == part] for part in np.unique(self.part)]
        return float(sum(travelled_m(part)[-1] for part in parts))


@dataclass(slots=True)
class Replay:
    """A finished run."""

    source: ReplayInput
    config: EnvConfig
    engine: Engine
    odom_poses: Array
    """(steps, robots, 3) poses of the front ends after each step."""
    is_lost: Array
    """(steps, robots) bool: whether each robot was lost in a finished map after each step; without one, (steps, 0)."""
    elapsed_s: float

    @property
    def robots(self) -> int:
        """Number of robots."""
        return self.odom_poses.shape[1]

    def paths(self) -> list[RobotPath]:
        """The path of each robot that has frames."""
        found = []
        for robot in sorted({frame.robot for frames in self.source.steps for frame in frames}):
            rows = [(k, f) for k, frames in enumerate(self.source.steps) for f in frames if f.robot == robot]
            own = [frame for _, frame in rows]
            odom = self.odom_poses[[k for k, _ in rows], robot]
            poses, part, group = self._in_map(robot, np.array([frame.step for frame in own]), odom)
            if self._finished_group is not None:
                group[self.is_lost[[k for k, _ in rows], robot] & (group == self._finished_group)] = -1
            times_s = np.array([self.source.begun_s[robot] + frame.time_s for frame in own])
            mount, logged = self.source.mounts[robot], None
            if self.source.odometry is not None:
                logged = self.source.odometry[robot]
                odometry = between(logged[0], logged)
            else:
                odometry = np.array(list(accumulate((f.odometry for f in own), compose, initial=np.zeros(3)))[1:])
            if mount.any():
                poses = compose(poses, inverse(mount))
            name = self.source.names[robot]
            logged = odometry if logged is None else logged
            at_end = self.engine.team.group_index(robot)
            found.append(RobotPath(robot, name, times_s, poses, odometry, logged, part, group, at_end))
        return found

    def _in_map(self, robot: int, steps: Array, odom: Array) -> tuple[Array, Array, Array]:
        """(frames, 3) poses, each relative to the latest keyframe and in the map of the group that has it; then part
        and group of each, as in `RobotPath`.

        steps (frames,): numbers of its frames, odom (frames, 3): poses of its front end.
        """
        mapper, team = self.engine.mapper_of(robot), self.engine.team
        taken, poses = mapper.keyframe_steps(robot), mapper.poses_of(robot)
        if not len(taken):
            none = np.zeros(len(steps), np.int64)
            return odom, none, none + team.group_index(robot)
        own = mapper.segments.of(robot)
        parts = np.repeat(np.arange(len(own)), [len(mapper.segment_path(segment)[1]) for segment in own])
        at = np.clip(np.searchsorted(steps, taken), 0, len(steps) - 1)
        held = np.clip(np.searchsorted(taken, steps, side="right") - 1, 0, None)
        groups = np.array([mapper.group_of_segment(segment) for segment in own])
        if mapper is not team:  # without a central mapper, each robot numbers the groups of its own maps
            groups = np.where(groups == mapper.group_index(robot), team.group_index(robot), -1)
        return compose(poses[held], between(odom[at[held]], odom)), parts[held], groups[parts[held]]

    @property
    def _finished_group(self) -> int | None:
        """Number of the group that has the map in which robots are localised, if that is what the engine does."""
        team = self.engine.team
        if team.prior is None or not isinstance(self.engine, MapLocalisation):
            return None
        return team.group_of_segment(team.prior)

    def table(self) -> list[dict]:
        """One row per robot, with units."""
        team, rows, order = self.engine.team, [], groups_by_size(self.engine.team)
        for path in self.paths():
            robot = path.robot
            closures = [
                c
                for c in team.closures
                if robot in (self.owner(c.candidate.target[0]), self.owner(c.candidate.source[0]))
            ]
            rows.append(
                {
                    "robot": path.name or str(robot),
                    "map": order.index(team.group_index(robot)) + 1,
                    "time [s]": round(float(path.times_s[-1] - path.times_s[0]), 1),
                    "path [m]": round(path.length_m, 2),
                    "odometry path [m]": round(float(travelled_m(path.odometry)[-1]), 2),
                    "scans": len(path.times_s),
                    "keyframes": len(team.keyframe_steps(robot)),
                    "closures": sum(c.status == "accepted" for c in closures),
                    "end x [m]": round(float(path.estimated[-1, 0]), 3),
                    "end y [m]": round(float(path.estimated[-1, 1]), 3),
                    "end heading [deg]": round(float(np.degrees(path.estimated[-1, 2])), 2),
                }
            )
        return rows

    def maps(self) -> list[str]:
        """Who is in each map, by name, in the order of the numbers in the table."""
        team, found = self.engine.team, []
        for group in groups_by_size(team):
            robots = [robot for robot in range(self.robots) if team.group_index(robot) == group]
            owners = {self.owner(segment) for segment in team.groups[group].robots}
            told = self._named("robot", robots) if robots else "the prior map" if NO_ROBOT in owners else ""
            found.append(told or f"{self._named('robot', sorted(owners))} before being carried")
        return found

    def by_name(self, line: str) -> str:
        """A line of the engine, which numbers robots, with their names."""
        told = re.compile(r"\brobots? (\d+(?:, \d+)*)")
        return told.sub(lambda found: self._named("robot", [int(each) for each in found[1].split(", ")]), line)

    def _named(self, what: str, robots: list[int]) -> str:
        names = [self.source.names[robot] or str(robot) for robot in robots]
        return f"{what}{'s' * (len(names) > 1)} {', '.join(names)}"

    def owner(self, segment: int) -> int:
        """The robot of a segment."""
        return self.engine.team.segments.owners[segment]


def groups_by_size(team: TeamMapper) -> list[int]:
    """Numbers of the groups of robots that share a map, as their maps are numbered: first those with most robots, then
    with most keyframes."""

    def size(group: int) -> tuple[int, int]:
        segments = team.groups[group].robots
        robots = sum(segment in segments for segment in team.segments.current)
        return robots, sum(len(team.keyframes[segment]) for segment in segments)

    return sorted(range(len(team.groups)), key=size, reverse=True)


def engine_robots(source: ReplayInput, config: EnvConfig) -> int:
    """Number of robots of the engine: those that have frames or are named, and of a mixed team all."""
    if config.robot:
        return config.robots
    if source.contacts:
        return int(source.contacts[0].heard.shape[1])
    seen = 1 + max(frame.robot for frames in source.steps for frame in frames)
    return max(seen, 1 if source.is_episode else len(source.names))


def run(source: ReplayInput, config: EnvConfig, watch: Callable[[int, Engine], None] | None = None) -> Replay:
    """Run the engine on all frames; watch: called after every step with its number and the engine."""
    begun = time.monotonic()
    contacts, steps = source.contacts, source.steps
    engine = make_engine(config, engine_robots(source, config), prior_of(config))
    first = next(frames[0].step - k for k, frames in enumerate(steps) if frames)
    localisers = engine.localisers if isinstance(engine, MapLocalisation) else []
    odom_poses, is_lost, step, bar = [], [], first, Bar(len(steps), "steps", every=50)
    for step, frames in enumerate(steps, first):  # steps in the frames may differ between robots
        if frames:
            engine.track(frames)
        engine.absorb(step, contacts[step - first] if contacts else None)
        odom_poses.append(np.array(engine.poses_odom))
        is_lost.append([own.is_lost for own in localisers])
        if watch is not None:
            watch(step - first, engine)
        bar.show(step - first + 1)
    last = max([step, *(frame.step for frame in steps[-1])])
    if last >= config.max_cycles or not source.is_episode:  # a complete episode: the backlog is processed
        engine.finish()
    return Replay(source, config, engine, np.array(odom_poses), np.array(is_lost), time.monotonic() - begun)
