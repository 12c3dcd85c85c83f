"""The files of a leaderboard: JSON, CSV, Markdown, LaTeX, pictures and one HTML page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from twc_env._version import __version__
from twc_env.config import digest
from twc_env.errors import DataError
from twc_env.records.class_file import digest_of, is_in_file
from twc_env.records.json_values import write_json
from twc_env.records.text_tables import csv_text
from twc_env.running.finished_parts import code_digest
from twc_env.running.output_folder import remove_stale
from twc_env.suite.entries import INFORMED, Entry
from twc_env.suite.page import page_of
from twc_env.suite.standings import Standings
from twc_env.suite.tables import latex_of, markdown_of
from twc_env.tasks import task_config

ROW_KEYS = ("task", "team", "score", "low", "high", "wrong_merges", "merged_s", "ate_m", "coverage_mean")
"""What a row of `--json` holds, besides `score_is`."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What was played."""

    suite: str
    split: str
    buildings: int
    """Per task: the first of the split; the number of each is the seed of its episodes."""

    @property
    def title(self) -> str:
        """Heading of the page."""
        return f"Leaderboard of suite {self.suite}"

    def lead(self, standings: Standings) -> str:
        """One paragraph: what was played by which code, and how scores are to be read."""
        counted = f"building and seed 0 to {self.buildings - 1}" if self.buildings > 1 else "building and seed 0"
        tasks = f"{len(standings.tasks)} task{'s' if len(standings.tasks) > 1 else ''}"
        text = (
            f"{len(standings.teams)} teams in {tasks} of suite {self.suite}, {self.split} split, {counted} of each: "
            f"{len(standings.teams) * len(standings.tasks) * self.buildings} episodes, twc_env {__version__}, "
            f"code {code_digest('twc_env.agents')}."
        )
        if own := file_digests(standings.teams):
            text += f" Files of teams: {', '.join(f'{team} {digits}' for team, digits in own.items())}."
        return text if standings.is_normalised else f"{text} {raw_remark(standings)}"

    def as_json(self, entries: Sequence[Entry]) -> dict[str, Any]:
        """Plain values."""
        configs = {entry.task: entry.config for entry in entries}
        own = file_digests(dict.fromkeys(entry.team for entry in entries))
        return {
            "suite": self.suite,
            "split": self.split,
            "buildings": self.buildings,
            "seeds": list(range(self.buildings)),
            "version": __version__,
            "code_digest": code_digest("twc_env.agents"),
            **({"agent_digests": own} if own else {}),
            "tasks": {
                task: {
                    "config_digest": digest(task_config(task)),
                    "robots": config.robots,
                    "budget_s": config.max_cycles * config.dynamics.time_step_s,
                    "ends_at_coverage": config.episode.ends_at_coverage,
                }
                for task, config in configs.items()
            },
        }


def file_digests(teams: Iterable[str]) -> dict[str, str]:
    """Team -> digest of its files, of the teams that a file holds."""
    return {team: digest_of(team) for team in teams if is_in_file(team)}


def raw_remark(standings: Standings) -> str:
    """Why scores are not normalised, in one sentence."""
    if INFORMED in standings.teams:
        why = "the informed team did not beat the random one in every task"
    else:
        why = f"there is no team {INFORMED!r} in this version"
    return f"Scores are not normalised, since {why}: they are the mean coverage itself."


def rows_as_json(standings: Standings) -> list[dict[str, Any]]:
    """The rows for `--json`."""
    kind = "normalised" if standings.is_normalised else "mean coverage"
    return [{**{key: getattr(row, key) for key in ROW_KEYS}, "score_is": kind} for row in standings.rows]


def write_leaderboard(
    standings: Standings,
    origin: Origin,
    entries: Sequence[Entry],
    folder: Path,
    pictures: tuple[str, float | None] | None,
) -> list[Path]:
    """Write all files; returns their paths. Pictures that an earlier run drew, and this one does not, are removed.

    pictures: format, besides PNG, which the page holds, and dpi; None for no pictures. Raises DataError if a file
    cannot be written.
    """
    lead = origin.lead(standings)
    written = [folder / "leaderboard.json"]
    write_json(written[0], {**origin.as_json(entries), **standings.as_json()})
    texts = {
        "leaderboard.csv": csv_text([asdict(row) for row in standings.rows]),
        "leaderboard.md": markdown_of(standings, lead),
        "leaderboard.tex": latex_of(standings),
    }
    drawn: list[tuple[str, Path]] = []
    try:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
            written.append(folder / name)
        if pictures is not None:
            from twc_env.pictures.style import style
            from twc_env.suite.pictures import draw_curves, draw_profiles

            with style():
                for title, stem, draw in (
                    ("Performance profiles", "profiles", draw_profiles),
                    ("Floor in a correctly merged map over time", "curves", draw_curves),
                ):
                    paths = [folder / f"{stem}.{kind}" for kind in dict.fromkeys(("png", pictures[0]))]
                    for path in paths:
                        draw(standings, path, pictures[1])
                    drawn.append((title, paths[0]))
                    written += paths
        (folder / "leaderboard.html").write_text(page_of(standings, origin.title, lead, drawn), encoding="utf-8")
        written.append(folder / "leaderboard.html")
        remove_stale(folder, ("profiles", "curves"), written)
    except OSError as error:
        raise DataError(f"cannot write to {folder}: {error.strerror}; choose another with --out") from error
    return written
