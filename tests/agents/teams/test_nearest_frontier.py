"""The nearest-frontier team: exploration, spreading out, unreachable goals, tours, and termination."""

import math

import numpy as np
import pytest
from twc_env.agents.shared.explorer_state import ExplorerConfig
from twc_env.agents.teams.nearest_frontier import NearestFrontier

from twc_env import EnvConfig
from twc_env.config import override
from twc_env.records.messages import Belief, GridMap, KnownSign

CELL_M = 0.1


class Maze:
    """Robots with perfect sensors and localisation in a building drawn as text."""

    def __init__(self, rows, starts, merged=True, seed=0):
        picture = np.array([list(row) for row in rows[::-1]])
        self.wall = np.kron(picture == "#", np.ones((5, 5), bool))
        self.seen = [np.zeros(self.wall.shape, np.int16)] * len(starts) if merged else None
        if not merged:
            self.seen = [np.zeros(self.wall.shape, np.int16) for _ in starts]
        self.poses = [np.array(start, float) for start in starts]
        self.merged, self.step, self.version, self.bumps = merged, 0, 0, 0
        self.agents = [f"robot_{i}" for i in range(len(starts))]
        self.policy = NearestFrontier(EnvConfig(robots=len(starts)))
        self.policy.reset(seed, self.agents)
        self.signs: tuple[KnownSign, ...] = ()
        self.look()

    def look(self):
        self.ranges = []
        for i, pose in enumerate(self.poses):
            self.ranges.append(self.scan(i, pose))

    def scan(self, robot, pose, beams=120, reach_m=8.0):
        ranges = np.full(beams, reach_m)
        seen = self.seen[robot]
        teammates = [p for j, p in enumerate(self.poses) if j != robot]
        for k in range(beams):
            angle = pose[2] + 2 * math.pi * k / beams
            for r in np.arange(0.0, reach_m, 0.05):
                x, y = pose[0] + r * math.cos(angle), pose[1] + r * math.sin(angle)
                row, column = int(y / CELL_M), int(x / CELL_M)
                if any(math.hypot(p[0] - x, p[1] - y) < 0.2 for p in teammates):
                    ranges[k] = r
                    break
                if self.wall[row, column]:
                    ranges[k] = r
                    seen[row, column] = 20
                    break
                seen[row, column] = -20
        return ranges

    def beliefs(self):
        grid = [GridMap(seen, np.zeros(2), CELL_M) for seen in self.seen]
        return {
            agent: Belief(
                i, self.step, self.poses[i].copy(), grid[i],
                {j: p.copy() for j, p in enumerate(self.poses) if j != i and self.merged},
                self.signs, self.ranges[i], self.version,
            )
            for i, agent in enumerate(self.agents)
        }  # fmt: skip

    def advance(self):
        actions = self.policy.act(self.beliefs())
        for i, agent in enumerate(self.agents):
            speed, turn_rate = actions[agent] * [1.0, 1.5]
            pose = self.poses[i]
            heading = pose[2] + 0.05 * turn_rate
            x, y = pose[0] + 0.1 * speed * math.cos(heading), pose[1] + 0.1 * speed * math.sin(heading)
            if self.is_free(i, x, y):
                pose[:2] = x, y
            else:
                self.bumps += 1
            pose[2] = math.remainder(pose[2] + 0.1 * turn_rate, 2 * math.pi)
        self.step += 1
        if self.step % 4 == 0:
            self.look()

    def is_free(self, robot, x, y):
        angles = np.linspace(0, 2 * np.pi, 16)
        rows, columns = ((v / CELL_M).astype(int) for v in (y + 0.18 * np.sin(angles), x + 0.18 * np.cos(angles)))
        others = [p for j, p in enumerate(self.poses) if j != robot]
        return not self.wall[rows, columns].any() and all(math.hypot(p[0] - x, p[1] - y) > 0.4 for p in others)

    def run(self, steps):
        for _ in range(steps):
            self.advance()
            if self.policy.finished(self.beliefs()):
                return True
        return False


TWO_ROOMS = [
    "####################",
    "#        #         #",
    "#        #         #",
    "#        #         #",
    "#                  #",
    "#                  #",
    "#        #         #",
    "#        #         #",
    "####################",
]


def floor_seen(maze):
    free = ~maze.wall
    return (maze.seen[0][free] < 0).mean()


def test_one_robot_explores_both_rooms_and_reports_the_end():
    maze = Maze(TWO_ROOMS, [(1.5, 1.5, 2.0)])
    assert maze.run(500)
    assert floor_seen(maze) > 0.97
    assert maze.bumps == 0


def test_two_robots_go_to_different_rooms():
    corridor = [
        "##############################",
        "#         #        #         #",
        "#         #        #         #",
        "#                            #",
        "#                            #",
        "#         #        #         #",
        "#         #        #         #",
        "##############################",
    ]
    maze = Maze(corridor, [(7.0, 1.9, 1.5), (7.8, 1.9, 1.5)])
    ends = []
    for _ in range(120):
        maze.advance()
        ends.append([p[0] for p in maze.poses])
    reach = np.array(ends)
    assert reach.min() < 4.9
    assert reach.max() > 9.6
    assert maze.bumps == 0


def test_a_frontier_behind_a_narrow_gap_is_given_up():
    rows = [row.replace("#                  #", "#        #         #") for row in TWO_ROOMS]
    maze = Maze(rows, [(1.5, 1.5, 0.0)])
    row = maze.wall.shape[0] // 2
    maze.wall[row : row + 3, 45:50] = False
    maze.look()
    assert maze.run(700)
    assert maze.poses[0][0] < 4.6


def test_unmerged_robots_tour_the_signs_and_never_finish():
    maze = Maze(TWO_ROOMS, [(1.5, 1.5, 0.0), (8.0, 3.0, 0.0)], merged=False)
    maze.signs = (KnownSign("EXIT", np.array([0.5, 3.5])), KnownSign("LAB", np.array([9.4, 1.0])))
    nearest = np.full((2, 2), np.inf)
    for _ in range(900):
        maze.advance()
        if maze.step > 300:
            for i, pose in enumerate(maze.poses):
                away = [math.hypot(*(pose[:2] - sign.position_m)) for sign in maze.signs]
                nearest[i] = np.minimum(nearest[i], away)
    assert nearest.max() < 1.5
    assert not maze.policy.finished(maze.beliefs())


def test_goals_follow_a_jump_of_the_map_frame():
    maze = Maze(TWO_ROOMS, [(1.5, 1.5, 0.0)])
    for _ in range(40):
        maze.advance()
    robot = maze.policy.robots["robot_0"]
    goal, pose = robot.goal_m.copy(), robot.pose.copy()
    distance = math.hypot(*(goal - pose[:2]))
    belief = maze.beliefs()["robot_0"]
    turned = np.array([-pose[1], pose[0], pose[2] + math.pi / 2])
    maze.policy._observe(robot, Belief(0, maze.step, turned, belief.grid, {}, (), None, 1))
    assert math.hypot(*(robot.goal_m - turned[:2])) == pytest.approx(distance, abs=1e-6)
    assert np.allclose(robot.goal_m, [-goal[1], goal[0]])
    assert robot.replan


def test_a_robot_plans_where_the_frames_of_all_steps_are_lost_in_which_it_usually_does():
    """The first map is empty, so there is no goal; the next ones are looked at although each step that is a multiple of
    five is never known."""
    maze, empty = Maze(TWO_ROOMS, [(1.5, 1.5, 0.0)]), np.zeros((20, 20), np.int16)
    belief = Belief(0, 0, maze.poses[0], GridMap(empty, np.zeros(2), CELL_M), {}, (), None, 1)
    for step in range(60):
        if step % 5:
            known = maze.beliefs()["robot_0"]
            belief = Belief(0, step, known.pose_map_robot, known.grid, {}, (), known.ranges_m, 1)
        maze.policy.act({"robot_0": belief})
    assert maze.policy.robots["robot_0"].goal_kind == "frontier"


def test_a_robot_that_cannot_move_excludes_its_goal():
    maze = Maze(TWO_ROOMS, [(1.5, 1.5, 0.0)])
    maze.is_free = lambda robot, x, y: False
    for _ in range(400):
        maze.advance()
    robot = maze.policy.robots["robot_0"]
    assert len(robot.failures) >= 1
    assert all(failure.until_step > 0 for failure in robot.failures)


def test_an_empty_map_without_scan_gives_valid_actions():
    policy = NearestFrontier(EnvConfig(robots=1), ExplorerConfig())
    policy.reset(0, ["robot_0"])
    for step in range(100):
        belief = Belief(0, step, np.zeros(3), GridMap(np.zeros((0, 0), np.int16), np.zeros(2), CELL_M))
        action = policy.act({"robot_0": belief})["robot_0"]
        assert np.isfinite(action).all()


def test_a_robot_enclosed_by_its_map_plans_with_a_smaller_radius():
    kind = np.full((60, 100), -20, np.int16)
    kind[[0, -1]] = kind[:, [0, -1]] = 20
    kind[:, 14] = kind[20, :15] = 20
    kind[8:12, 14] = -20
    policy = NearestFrontier(EnvConfig(robots=1))
    policy.reset(0, ["robot_0"])
    belief = Belief(0, 0, np.array([0.7, 1.0, 0.0]), GridMap(kind, np.zeros(2), CELL_M))
    policy.act({"robot_0": belief})
    robot = policy.robots["robot_0"]
    assert robot.goal_kind == "tour"
    assert robot.goal_m[0] > 1.5
    kind[8:12, 14] = 20
    policy.reset(0, ["robot_0"])
    policy.act({"robot_0": belief})
    assert policy.robots["robot_0"].goal_kind == ""


def test_a_robot_plans_on_its_own_map_even_if_its_teammate_holds_another():
    team, agents = NearestFrontier(EnvConfig(robots=2)), ["robot_0", "robot_1"]
    team.reset(0, agents)
    known = [np.zeros((40, 60), np.int16) for _ in agents]
    known[0][5:20, 5:20], known[1][5:35, 5:55] = -100, -100
    beliefs = {
        agent: Belief(i, 1, np.array([1.0, 1.0, 0.0]), GridMap(cells, np.zeros(2), CELL_M), {1 - i: np.ones(3)})
        for i, (agent, cells) in enumerate(zip(agents, known, strict=True))
    }
    open_cells = [int((team._terrain(agent, beliefs).cost > 0).sum()) for agent in agents]
    assert open_cells[1] > 4 * open_cells[0]


SHUT = [row.replace("#                  #", "#        #         #") for row in TWO_ROOMS]


def with_doors(maze, share=0.5):
    maze.policy = NearestFrontier(override(EnvConfig(robots=1), {"clutter.door_share": share}))
    maze.policy.reset(0, maze.agents)
    return maze


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_robot_leaves_by_a_door_that_is_still_a_wall_of_its_map(share):
    maze = with_doors(Maze(SHUT, [(1.5, 1.5, 0.0)]), share)
    maze.run(150)
    maze.seen[0][maze.seen[0] > 0] = 20_000  # shut for so long that the map takes long to notice the change
    middle = maze.wall.shape[0] // 2
    maze.wall[middle - 4 : middle + 5, 45:50] = False
    write, maze.look = maze.look, lambda: None
    for _ in range(300):
        maze.advance()
        if maze.step % 4 == 0:
            known = maze.seen[0].copy()
            write()
            maze.seen[0][known == 20_000] = 20_000
    assert (maze.poses[0][0] > 5.0) == (share > 0.0)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_robot_shut_in_a_closet_looks_around_and_then_waits_for_the_door(share):
    maze = with_doors(Maze(["####", "#  #", "#  #", "####"], [(1.0, 1.0, 0.0)]), share)
    turns = []
    for _ in range(400):
        before = maze.poses[0][2]
        maze.advance()
        turns.append(abs(math.remainder(maze.poses[0][2] - before, 2 * math.pi)) > 0.01)
    assert np.mean(turns[:30]) > 0.9
    assert (np.mean(turns) < 0.5) == (share > 0.0)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_robot_shut_in_a_small_room_waits_somewhere_else_after_a_while(share):
    """A leaf that opens may have met it, or stand open between it and the doorway."""
    maze = with_doors(Maze(["######", *["#    #"] * 4, "######"], [(1.5, 1.5, 0.0)]), share)
    path = []
    for _ in range(400):
        maze.advance()
        path.append(maze.poses[0][:2].copy())
    away = np.hypot(*(np.array(path) - path[0]).T)
    assert away[:190].max() < 0.1 and (np.diff(away[250:390]) == 0.0).mean() > 0.9
    assert (away.max() > 0.4) == (share > 0.0)
