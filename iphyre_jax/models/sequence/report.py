"""docs/results/sequence.md from the evaluations of the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.files import replace_text
from iphyre_jax.models.sequence.evaluation import CANDIDATES, RANDOM, split_means
from iphyre_jax.models.sequence.settings import ASKED
from iphyre_jax.provenance import made_by
from iphyre_jax.train.reports.report import markdown_table

SPLITS_SHOWN: Final = {
    "basic": "basic",
    "unseen_basic": "unseen basic",
    "noisy": "noisy",
    "compositional": "compositional",
    "multi_ball": "multi-ball",
    "all": "all forty",
}
MODES: Final = ("greedy", "sampled", "contrast")
ABOUT: Final = f"""# Sequence models

Written by `make results-sequence`; do not edit. A causal transformer over returns, states and actions is asked for a
return of {ASKED} of 1000 points and plays. Mean reward / games solved, %.

* Data and evaluation share rate, rule and reset: 60 steps a second, rule "simulate", fresh space; 10 steps a second,
  rule "in_advance", second reset. Both in float64. Rates have tables of their own.
* Official data: 50 plays that solve and 50 that fail of each basic game. Large: up to 1,000 and 1,000 of each, and
  plays of variations of basic games, of which combined and on the fly one in 16 counts. Noisy, compositional and
  multi-ball are never learned from, nor used to choose anything.
* The paper makes 100 passes over its plays. Its rows here make fewer: half as many in advance, an eighth combined, next
  to one on the fly, where the loss still falls at the end. So rows of different strategies differ in training too.
* `paper-as-coded` learns the labels of the official code with their faults: in advance the return is reversed, on the
  fly it is constant, combined the times are halved. `paper` has them right. `clone-solved` and `clone-all` see no
  return. `ours` learns events: which block goes next, and after how long. It looks again when that block has gone, also
  in `ours-on-the-fly-large`: on the fly by its rate and its plays, not by its decisions.
* Greedy plays the likeliest action; of times, a block goes if that is likelier than not. That rule came after a row of
  official data had been seen, on all forty games. Sampled draws actions. Contrast draws {CANDIDATES} plans and plays
  the one that a high return makes likelier most, compared with a failure.
* Nearest neighbour plays solving plans of the most similar basic game; on basic that is a game's own solution. Random
  plans are the first {RANDOM} official ones of each game, played now.
* Mean over seeds ± standard deviation over seeds; a row says how many there are.
* `models/sequence/`, beside this page, has settings, log and scores of each row.
"""


def pair(reward: Sequence[float], success: Sequence[float]) -> str:
    """Mean reward, with its spread over seeds, and share solved in %."""
    spread = f" ± {np.std(reward, ddof=1):.0f}" if len(reward) > 1 else ""
    return f"{np.mean(reward):.1f}{spread} / {100 * np.mean(success):.0f}"


def result_cells(found: Mapping[str, Any]) -> list[str]:
    """The cells of a result: every split, and the standard error over episodes."""
    means = [split_means(found, split) for split in SPLITS_SHOWN]
    error = found["standard error over episodes, all"]
    return [*(pair(*(each.tolist() for each in one)) for one in means), "-" if error is None else f"{error:.1f}"]


def table(
    found: Mapping[str, Mapping[str, Any]],
    bounds: Mapping[str, Any],
    best: Mapping[str, tuple[float, float]] | None,
) -> str:
    """One rate: the bounds, then each row in each mode of play."""
    rows = [[name, "-", "-", *result_cells(each)] for name, each in bounds.items()]
    if best is not None:
        cells = [pair([best[split][0]], [best[split][1]]) if split in best else "-" for split in SPLITS_SHOWN]
        rows.append(["best known plans", "-", "-", *cells, "-"])
    for name, each in found.items():
        for mode in MODES:
            if mode in each["modes"]:
                seeds = str(len(each["modes"][mode]["reward"]))
                rows.append([name, mode, seeds, *result_cells(each["modes"][mode])])
    return markdown_table(["row", "actions", "seeds", *SPLITS_SHOWN.values(), "standard error"], rows)


def sweep_table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Mean reward by the return asked for, basic and all forty games, first seed, greedy."""
    asked = sorted({value for each in found.values() for value in each["modes"]["sweep"]}, key=float)
    rows = []
    for name, each in found.items():
        cells = [each["modes"]["sweep"].get(value) for value in asked]
        rows.append([name, *("-" if cell is None else f"{cell[0]:.0f} / {cell[1]:.0f}" for cell in cells)])
    return markdown_table(["row", *asked], rows)


def training_table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """What each row was trained with."""
    names = ("data", "strategy", "context", "updates", "batch_size", "learning_rate", "solved_share")
    rows = [
        [name, str(each["parameters"]), *(str(each["settings"][key]) for key in names)] for name, each in found.items()
    ]
    return markdown_table(["row", "numbers", *(name.replace("_", " ") for name in names)], rows)


def write(
    out: Path,
    found: Mapping[str, Mapping[str, Any]],
    bounds: Mapping[int, Mapping[str, Any]],
    best: Mapping[int, Mapping[str, tuple[float, float]]],
    missing: Sequence[str],
    facts: Mapping[str, Any],
) -> None:
    """Write the document.

    Args:
        out: of the document.
        found: evaluations by name of the row, in the order shown.
        bounds: by rate, results of what learns nothing.
        best: by rate and split, mean reward and share solved of the best known plans.
        missing: rows that are not trained yet.
        facts: provenance, JSON values.
    """
    parts = [ABOUT]
    for fps in sorted(bounds, reverse=True):
        own = {name: each for name, each in found.items() if each["settings"]["fps"] == fps}
        parts += [f"## {fps} steps a second", table(own, bounds[fps], best.get(fps))]
    if missing:
        parts.append(f"Not trained yet: {', '.join(missing)}.")
    parts.append("Standard error: of the mean over all forty games, from several episodes of each game.")
    parts += [
        "## Other returns",
        "Mean reward on basic / all forty games by the return asked for; first seed, greedy. A flat line ignores it.",
        sweep_table(found),
    ]
    parts += ["## Training", training_table(found)]
    parts.append(made_by(facts))
    replace_text(out, "\n\n".join(part.strip() for part in parts) + "\n")
