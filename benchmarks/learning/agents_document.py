"""The documents of `benchmarks.learning.agents`, from the runs that are published."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from benchmarks import plots
from benchmarks.learning.rows import PREDICTIONS, controllers, without_sums
from iphyre_jax.analyses import oracle
from iphyre_jax.files import read_json_object
from iphyre_jax.paper import paper_numbers
from iphyre_jax.provenance import provenance
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.report import TITLES as SPLIT_TITLES
from iphyre_jax.train.reports.report import markdown_table
from iphyre_jax.train.reports.statistics import Summary
from iphyre_jax.train.storage import logs, runs

OFFICIAL: Final = (
    "The official stack in advance: 200 iterations of 4,000 episodes of 150 steps, at a measured 43.6 us a step, take "
    "5,200 s of simulation alone. On the fly an iteration has 4,000 decisions of one step, in all 35 s. Ours: "
    "everything counts, compilation too (but not in the last column)."
)
TITLES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "results-controllers": "# Agents that see predictions\n\nTo the official observation comes the table 0.1 s "
        "later if nothing is removed now: by a world model (seed 0 of its row in `world.md`), by the simulator "
        "(perfect), or zeros in its place. `objects` learned from basic games and variations of them, `mdrnn` from "
        "basic games. `objects` is given the true velocities, which the agent is not; `mdrnn` sees places alone, "
        "remembers on the fly, and begins anew at each decision of a combined agent. Perfect, and motion (the true "
        "velocities), show what this learner makes of knowing more; they are no bounds, for other columns exceed "
        "them. SAC, and `objects` of PPO and A2C, were trained beside other work: their seconds are too many.",
        "results-paper": "# Results by the paper's settings\n\nSettings of the paper and of its code, with RLlib's "
        "defaults where that code sets nothing, in our trainer; below them the paper's own numbers. The docstring of "
        "`iphyre_jax/train/settings/presets.py` names what RLlib does otherwise. DDPG-I ends at doing nothing: within "
        "its first updates it comes to times that remove nothing, 0 or 15 s, where its network has no gradient. The "
        "paper's DDPG can only act from 7.5 to 15 s, but that alone does not explain its score "
        "(`docs/decisions/training.md`). SAC-O diverges in all seeds: its entropy stays under the target, so alpha "
        "grows to tens and hundreds of thousands of points a nat, and its values are noise.",
    }
)  # of documents that are not simply results
PAPER_BASIC: Final = paper_numbers()["agents"]["PPO-I"]["basic"][0]  # points
TO_PAPER: Final = f"s to {PAPER_BASIC:.1f} on basic (median)"
FIRST_TIME: Final = (
    f"{TO_PAPER}: until greedy play first reaches it, from the end of the first update, which compiles. A seed that "
    'never does counts as later than all others; "never": half of them or more. What is lost later does not show.'
)


def document(all_runs: Sequence[compare.Evaluated], missing: Sequence[str], out: Path, stem: str) -> str:
    """The text of the document; draws its pictures."""
    commits = {str(read_json_object(run.path / runs.EVALUATION)["commit"]) for run in all_runs}
    origin = json.dumps({**provenance(), "commits of the runs": sorted(commits)}, indent=1)
    parts = [
        TITLES.get(stem, "# Results"),
        f"Written by `make {stem}`. Trained on the basic split only, or, where the row says so, on its variations and "
        "on generated scenes that are near no test game; everything else is zero shot. Greedy: one episode a game; "
        "sampled: 20, as the agent plays to learn. The paper samples too, and shows the best of five evaluations. "
        "Cells: mean over seeds, share solved, [95 % t interval over seeds], interquartile mean over games and seeds. "
        "People and oracle of the paper played at 60 fps, its agents at 10. `runs/` has settings, log and scores of "
        "each run.",
        f"Still missing: {', '.join(missing)}." if missing else "Nothing is missing.",
    ]
    for fps in (10, 60):
        of_rate = [run for run in all_runs if run.config.fps == fps]
        if not of_rate:
            continue
        table = compare.rows(of_rate)
        predicting = with_predictions(table)
        parts += [f"## {fps} fps", _best_known(fps)]
        if predicting:  # too many rows for the other pictures
            picture = out / f"{stem}-{fps}fps.png"
            plots.predictions(predicting, picture)
            parts += [*_added(predicting), f"![reward by what is seen at {fps} fps]({picture.name})"]
        parts += [compare.markdown(table), _unseen(table), "### Time"]
        parts += [OFFICIAL] if fps == OFFICIAL_FPS else []
        parts += [_times(table), *([FIRST_TIME] if fps == OFFICIAL_FPS else [])]
        for name, draw in () if predicting else (("curves", compare.draw_curves), ("bars", compare.draw_bars)):
            picture = out / f"{stem}-{name}-{fps}fps.png"
            draw(picture, table)
            parts.append(f"![{name} at {fps} fps]({picture.name})")
    parts += ["## Origin", f"```json\n{origin}\n```"]
    return "\n\n".join(parts) + "\n"


def with_predictions(table: Sequence[compare.Row]) -> dict[str, dict[str, compare.Row]]:
    """The rows of the table of controllers by agent and by what it sees; nothing if there are none."""
    found = {replace(without_sums(row.config), seed=0): row for row in table}
    agents: dict[str, dict[str, compare.Row]] = {}
    for name, config in controllers().items():
        if config in found:
            seen = name.removeprefix(f"{config.paper_name.lower()}-")
            agents.setdefault(config.paper_name, {})[seen] = found[config]
    return agents


def _added(agents: Mapping[str, Mapping[str, compare.Row]]) -> list[str]:
    """What each prediction adds to the same agent's reward without one, by split."""
    parts = [
        "### What a prediction adds\n\nReward of sampled actions, less that of the same agent and seeds without a "
        "prediction, whose own reward is in the first column; [95 % t interval over seeds]. An interval around "
        "0: no help is shown. Of so many intervals some miss 0 by chance."
    ]
    for split in ("basic", "all"):
        cells = []
        for agent, seen in agents.items():
            plain = seen.get("none")
            own = plain.summary("sampled", split) if plain else None
            others = [seen.get(name) for name in PREDICTIONS if name != "none"]
            added = [compare.difference(row, plain, "sampled", split) if row and plain else None for row in others]
            cells.append([agent, f"{own.mean:.1f}" if own else "-", *map(_signed, added)])
        parts.append(markdown_table([SPLIT_TITLES[split], *PREDICTIONS], cells))
    return parts


def _signed(value: Summary | None) -> str:
    if value is None:
        return "-"
    return f"{value.mean:+.1f}" + ("" if np.isnan(value.low) else f" [{value.low:+.0f}, {value.high:+.0f}]")


def _best_known(fps: int) -> str:
    """What the best plans known reach at a rate, beside the paper's oracle, which plays at 60 fps."""
    found = oracle.best_known(fps)
    each = ", ".join(f"{SPLIT_TITLES[split]} {reward:.1f}" for split, (reward, _) in found.items())
    return f"Best known plans at {fps} fps ([Oracle](oracle.md)): {each}."


def _unseen(rows: Sequence[compare.Row]) -> str:
    """The ten unseen layouts of the basic games."""
    cells = []
    for row, name in zip(rows, compare.names(rows), strict=True):
        values = [row.summary(kind, "unseen_basic") for kind in compare.KINDS]
        cells.append([name, *("-" if value is None else f"{value.mean:.1f}" for value in values)])
    return "### Unseen basic\n\n" + markdown_table(["agent", *compare.KINDS], cells)


def seconds_to_paper(run: compare.Evaluated) -> float:
    """Seconds until greedy plans first reach the paper's PPO-I on basic; infinity if they never do.

    Playing, learning and measuring count, from the end of the first update, which compiles.
    """
    lines = logs.read(run.path)
    for line in lines:
        if line["greedy_reward"] and float(line["greedy_reward"]) >= PAPER_BASIC:
            return float(line["seconds"]) - float(lines[0]["seconds"])
    return float("inf")


def _median_time(reached: Sequence[float]) -> str:
    """The median over all seeds: one that never arrives is later than all others, not left out."""
    if not reached:
        return "-"
    median, arrived = float(np.median(reached)), int(np.isfinite(reached).sum())
    return f"{f'{median:.1f}' if np.isfinite(median) else 'never'} ({arrived} of {len(reached)} seeds)"


def _times(rows: Sequence[compare.Row]) -> str:
    """Wall time of each row, and time to the paper's PPO-I."""
    at_its_rate = rows[0].config.fps == OFFICIAL_FPS
    header = ["agent", "episodes", "decisions", "training, s (median)", TO_PAPER]
    cells = []
    for row, name in zip(rows, compare.names(rows), strict=True):
        last = [logs.read(seed.path)[-1] for seed in row.seeds]
        to_paper = _median_time([seconds_to_paper(seed) for seed in row.seeds] if at_its_rate else [])
        middle = [float(np.median([float(line[column]) for line in last])) for column in ("episodes", "decisions")]
        wall = f"{np.median([float(line['seconds']) for line in last]):.0f}"
        cells.append([name, *(f"{value:,.0f}" for value in middle), wall, to_paper])
    return markdown_table(header, cells)
