"""Runs side by side: one row for the seeds of an agent, beside the paper's agents and people."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax.checks import check_least, show
from iphyre_jax.files import read_versioned
from iphyre_jax.paper import paper_numbers
from iphyre_jax.provenance import flat, in_words
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.scenes.library import GAME_LISTS
from iphyre_jax.train.evaluate import MEANS, READABLE, SCHEMA
from iphyre_jax.train.reports.printing import print_table
from iphyre_jax.train.reports.report import COLUMNS, TITLES, markdown_table, training_name
from iphyre_jax.train.reports.statistics import Summary, summary
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import logs, runs
from iphyre_jax.train.storage.named_files import without_paths

KINDS: Final = ("greedy", "sampled")
LARGEST: Final = 1e9  # size of a score
UPDATES: Final = re.compile("([0-9]{1,10}) of ")
RATES_OF_PAPER: Final = "The paper's agents play at 10 fps, its humans (best of five attempts) and oracle at 60 fps."


@dataclass(frozen=True)
class Evaluated:
    """One evaluated run."""

    path: Path
    config: TrainConfig
    games: Mapping[str, Mapping[str, Any]]  # name -> what evaluation.json says of it
    updates: int  # that its policy was trained for
    scenes: tuple[str, ...] = ()  # SHA-256 sums of the scene files that it was trained on

    def scores(self, kind: str, split: str, value: str = "reward") -> list[float]:
        """A value of each game of a split, or of the forty for "all"; nothing if one of them was not played."""
        names = GAME_LISTS[split]
        if not set(names) <= set(self.games):
            return []
        return [float(self.games[name][kind][value]) for name in names]


@dataclass(frozen=True)
class Row:
    """All seeds of one agent."""

    config: TrainConfig  # of any of them
    seeds: tuple[Evaluated, ...]

    @property
    def name(self) -> str:
        """Agent, preset, action head, observation, the network unless it is an MLP, a prediction, and the scenes.

        Of a policy from the middle of a run, the updates too.
        """
        config, updates = self.config, self.seeds[0].updates
        parts = [f"{config.paper_name} {config.preset}", config.head, config.observation]
        parts += [config.network] if config.network != "mlp" else []
        on = [f"on {training_name(config)}"] if config.games or config.split != "basic" else []
        besides = [*(["varied"] if config.variations else []), *(["generated"] if config.scene_pool else [])]
        predicted = [f"prediction {Path(config.prediction).name}"] if config.prediction else []
        part = [f"{updates} of {config.updates} updates"] if updates != config.updates else []
        return ", ".join([*parts, *predicted, *on, *besides, *part])

    def summary(self, kind: str, split: str, value: str = "reward") -> Summary | None:
        """Over the seeds; None if not all games of the split were played."""
        scores = [seed.scores(kind, split, value) for seed in self.seeds]
        return summary(scores) if all(scores) else None


def names(agents: Sequence[Row]) -> list[str]:
    """The names of rows; of equal ones, each with the settings in which they differ."""
    found = [row.name for row in agents]
    scenes = [" ".join(content[:8] for content in row.seeds[0].scenes) for row in agents]
    settings = [flat(row.config.to_json()) | {"scenes": own} for row, own in zip(agents, scenes, strict=True)]
    for name in set(found):
        alike = [k for k, one in enumerate(found) if one == name]
        keys = dict.fromkeys(key for k in alike for key in settings[k] if key not in ("seed", "games"))
        differing = [key for key in keys if len({repr(settings[k].get(key)) for k in alike}) > 1]
        for k in alike if len(alike) > 1 else ():
            shown = ((key, in_words(settings[k].get(key))) for key in differing)
            shorter = (f"{key} {value[:8] if key.endswith('_sha256') else value}" for key, value in shown)
            found[k] = ", ".join([name, *shorter])
    return found


def read(path: Path) -> Evaluated:
    """An evaluated run.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    config, file = runs.read_config(path), path / runs.EVALUATION
    if not file.is_file():
        raise FileNotFoundError(f"{path}: not evaluated yet, there is no {runs.EVALUATION}")
    content = read_versioned(file, SCHEMA, READABLE)
    # Older evaluations do not say so: they are of whole runs.
    made = content.get("updates trained", f"{config.updates} of {config.updates}")
    if not isinstance(made, str) or not (found := UPDATES.match(made)):
        raise ValueError(f"{file}: updates trained: expected N of {config.updates}, ..., got {show(made)}")
    games = {game["game"]: game for game in _checked_games(content.get("games"), file)}
    return Evaluated(path, config, games, int(found[1]), runs.scene_sums_of(path))


def _checked_games(games: object, file: Path) -> list[dict[str, Any]]:
    """The games of an evaluation.

    Raises:
        ValueError: one line; a score is missing or no finite number.
    """
    if not isinstance(games, list):
        raise ValueError(f"{file}: games: expected a list, got {show(games)}")
    for k, game in enumerate(games):
        if not isinstance(game, dict) or not isinstance(game.get("game"), str):
            raise ValueError(f"{file}: games: {k}: expected an object with the name of a game, got {show(game)}")
        for kind in KINDS:
            score = game.get(kind)
            for name in MEANS:
                found = score.get(name) if isinstance(score, dict) else None
                check_least(f"{file}: games: {k}: {kind}: {name}", found, -LARGEST)
    return games


def rows(evaluated: Sequence[Evaluated]) -> list[Row]:
    """One row for all runs of as many updates whose settings differ only in the seed, and scenes not at all.

    Raises:
        ValueError: one line; there are no runs, two have the same seed, or rates differ.
    """
    if not evaluated:
        raise ValueError("runs: expected at least one run folder")
    groups: dict[tuple[TrainConfig, int, tuple[str, ...]], list[Evaluated]] = {}
    for run in evaluated:
        alike = without_paths(dataclasses.replace(run.config, seed=0))
        groups.setdefault((alike, run.updates, run.scenes), []).append(run)
    rates = sorted({run.config.fps for run in evaluated})
    if len(rates) > 1:
        raise ValueError(f"runs: expected one frame rate, got {', '.join(map(str, rates))}: rates never share a table")
    for members in groups.values():
        seeds = [run.config.seed for run in members]
        if len(set(seeds)) < len(seeds):
            raise ValueError(f"runs: expected different seeds of {members[0].config.agent_name}, got {seeds}")
    return [Row(members[0].config, tuple(members)) for members in groups.values()]


def difference(row: Row, reference: Row, kind: str, split: str) -> Summary | None:
    """The reward of a row less that of another, over the seeds that both have; None if they share none.

    Args:
        row: of an agent.
        reference: of another.
        kind: "greedy" or "sampled".
        split: a split, or "all" forty games.
    """
    others = {seed.config.seed: seed.scores(kind, split) for seed in reference.seeds}
    pairs = [(seed.scores(kind, split), others.get(seed.config.seed, [])) for seed in row.seeds]
    differences = [np.subtract(one, other).tolist() for one, other in pairs if one and other]
    return summary(differences) if differences else None


def _cell(reward: Summary | None, success: Summary | None) -> str:
    """Mean reward, success, interval and interquartile mean in one cell."""
    if reward is None or success is None:
        return "-"
    spread = "" if np.isnan(reward.low) else f" [{reward.low:.0f}, {reward.high:.0f}]"
    return f"{reward.mean:.1f} {100 * success.mean:.0f}%{spread} iqm {reward.iqm:.0f}"


def table(agents: Sequence[Row], kind: str) -> list[list[str]]:
    """Cells of a table (name, seeds, splits): ours, then the paper's people, oracle and, at 10 fps, its agents."""
    cells = []
    for row, name in zip(agents, names(agents), strict=True):
        each = [_cell(row.summary(kind, split), row.summary(kind, split, "success")) for split in COLUMNS]
        cells.append([name, str(len(row.seeds)), *each])
    same = [row.config.paper_name for row in agents if row.config.fps == OFFICIAL_FPS]
    paper = paper_numbers()["agents"]
    for name in dict.fromkeys(["Human", "Oracle", *same]):
        if name in paper:
            each = [f"{paper[name][split][0]:.1f} {paper[name][split][1]:.0f}%" for split in COLUMNS]
            cells.append([f"paper: {name}", "-", *each])
    return cells


HEADER: Final = ("agent", "seeds", *(TITLES[split] for split in COLUMNS))


def markdown(agents: Sequence[Row]) -> str:
    """Tables of greedy and sampled rewards as Markdown."""
    parts = [f"### {kind.capitalize()} actions\n\n{markdown_table(HEADER, table(agents, kind))}" for kind in KINDS]
    return "\n\n".join(parts) + "\n"


def report(paths: Sequence[Path], console: Console, *, curves: Path | None, bars: Path | None) -> None:
    """Print the comparison of some runs and draw what is asked for.

    Raises:
        FileNotFoundError, ValueError: one line.
    """
    agents = rows([read(path) for path in paths])
    for kind in KINDS:
        shown = Table(title=f"{kind.capitalize()} actions, {_played(agents)}", box=box.SIMPLE, pad_edge=False)
        for title in HEADER:
            shown.add_column(title)
        for cells in table(agents, kind):
            shown.add_row(*cells)
        print_table(console, shown)
    console.print("Mean over seeds and share solved, [95 % t interval], interquartile mean.")
    console.print(RATES_OF_PAPER)
    if any("scene" in game for row in agents for seed in row.seeds for game in seed.games.values()):
        console.print("Scenes of your own have no column here; the evaluation.md of each run has their scores.")
    if curves is not None:
        draw_curves(curves, agents)
    if bars is not None:
        draw_bars(bars, agents)


def _played(agents: Sequence[Row]) -> str:
    """How the runs of a table play: rate, reset and number type, of which rows may have several."""
    resets, dtypes = ({str(getattr(row.config, name)) for row in agents} for name in ("resets", "dtype"))
    return f"{agents[0].config.fps} fps, reset {' or '.join(sorted(resets))}, {' or '.join(sorted(dtypes))}"


def _colour(k: int) -> tuple[float, float, float, float]:
    """The colour of row k: twenty, of which neighbours differ by more than their lightness."""
    import matplotlib  # loads slowly, and every command imports this module

    red, green, blue, alpha = matplotlib.colormaps["tab20"]((2 * k + (k % 20 >= 10)) % 20)
    return red, green, blue, alpha


def draw_curves(path: Path, agents: Sequence[Row]) -> None:
    """Learning curves: mean over seeds of each update's reward against decisions, with the range of the seeds."""
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    figure = Figure(figsize=(8, 5.5), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    for k, (row, name) in enumerate(zip(agents, names(agents), strict=True)):
        lines = [
            {int(line["update"]): line for line in logs.read(seed.path, ("reward", "decisions"))} for seed in row.seeds
        ]
        updates = sorted(set.intersection(*map(set, lines)))  # that all seeds have
        if len(updates) < 2:
            continue
        reward = np.array([[float(each[update]["reward"]) for update in updates] for each in lines])
        decisions = np.mean([[float(each[update]["decisions"]) for update in updates] for each in lines], axis=0)
        axes.plot(decisions, reward.mean(axis=0), linewidth=1.2, color=_colour(k), label=name)
        axes.fill_between(decisions, reward.min(axis=0), reward.max(axis=0), color=_colour(k), alpha=0.15)
    axes.set(xscale="log", xlabel="decisions", ylabel="mean reward of training episodes")
    axes.grid(alpha=0.3)
    figure.legend(fontsize="x-small", loc="outside lower center", ncols=3)
    figure.savefig(path)


def draw_bars(path: Path, agents: Sequence[Row]) -> None:
    """Rewards of sampled actions by split, one colour an agent, with the paper's people as a line over each split."""
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    figure = Figure(figsize=(9, 5), dpi=100, layout="constrained")
    axes, splits = figure.add_subplot(), COLUMNS[:-1]
    width = 0.85 / len(agents)
    for k, (row, name) in enumerate(zip(agents, names(agents), strict=True)):
        summaries = [row.summary("sampled", split) for split in splits]
        heights = [each.mean if each else 0.0 for each in summaries]
        low = [each.mean - each.low if each and each.seeds > 1 else 0.0 for each in summaries]
        high = [each.high - each.mean if each and each.seeds > 1 else 0.0 for each in summaries]
        places = np.arange(len(splits)) + (k - (len(agents) - 1) / 2) * width
        bars: dict[str, Any] = {"color": _colour(k), "error_kw": {"linewidth": 0.7}, "label": name}
        axes.bar(places, heights, width, yerr=[low, high], **bars)
    for k, split in enumerate(splits):
        human = paper_numbers()["agents"]["Human"][split][0]
        axes.hlines(human, k - 0.45, k + 0.45, color="black", linestyle="--", linewidth=1)
    axes.plot([], [], color="black", linestyle="--", label="paper: Human (60 fps, best of five)")
    axes.set_xticks(range(len(splits)), [TITLES[split] for split in splits])
    axes.set(ylabel=f"mean reward, sampled actions, {agents[0].config.fps} fps")
    axes.grid(axis="y", alpha=0.3)
    figure.legend(fontsize="x-small", loc="outside lower center", ncols=3)
    figure.savefig(path)
