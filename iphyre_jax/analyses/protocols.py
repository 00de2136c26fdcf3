"""What the protocol of a test does to the score of one fixed policy."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.shipped import shipped_model
from iphyre_jax.attempts.policies import policy_attempts
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.train.reports.report import markdown_table
from iphyre_jax.train.storage.pretrained import load_pretrained

POLICIES: Final = ("ppo-i", "a2c-i", "ddpg-i", "ppo-i-objects", "ppo-i-smooth")
EPISODES: Final = 20  # of a mean
BEST_OF: Final = 5
RUNS: Final = 5  # repetitions of the longest protocol

Floats = npt.NDArray[np.float64]


def settings(name: str) -> dict[str, Any]:
    """Return what decides a row."""
    return {**shipped_model("policy", name), "episodes": EPISODES * RUNS}


def measure(name: str) -> Row:
    """Play a policy at the rate and reset of its training; return each protocol's mean and spread over repetitions."""
    policy = load_pretrained(name)
    config = policy.config
    played = policy_attempts(
        config, policy.state, 1 + EPISODES * RUNS, greedy_first=True, fps=config.fps, resets=config.resets
    )
    return {
        "fps": config.fps,
        "resets": config.resets,
        "dtype": config.dtype,
        "protocols": {
            title: {"mean": float(np.mean(scores)), "spread": _spread(scores), "repetitions": len(scores)}
            for title, scores in protocol_scores(played.reward[:, 0, 0], played.reward[:, 0, 1:]).items()
        },
    }


def _spread(scores: Floats) -> float:
    """Return the standard deviation of single uses, estimated from some; 0 for one."""
    return float(np.std(scores, ddof=1)) if len(scores) > 1 else 0.0


def protocol_scores(greedy: Floats, sampled: Floats) -> dict[str, Floats]:
    """Return what each protocol would report, once for each of its repetitions.

    Args:
        greedy: (G,) rewards of the greedy episode of each game.
        sampled: (G, n) rewards of sampled episodes; a protocol of m episodes has n // m repetitions.
    """

    def groups(size: int) -> Floats:
        return sampled[:, : sampled.shape[1] // size * size].reshape(len(sampled), -1, size)

    return {
        "greedy": greedy.mean(keepdims=True),
        "one sampled episode": sampled.mean(axis=0),
        f"mean of {EPISODES} sampled episodes": groups(EPISODES).mean(axis=(0, 2)),
        f"best of {BEST_OF} evaluations, one episode each": groups(BEST_OF).mean(axis=0).max(axis=1),
        f"best of {BEST_OF} attempts at each game": groups(BEST_OF).max(axis=2).mean(axis=0),
    }


def run(folder: Path) -> dict[str, Row]:
    """Return the rows of all policies, playing those that are missing in `folder`/protocols."""
    return {name: kept_row(folder / "protocols", name, settings(name), partial(measure, name)) for name in POLICIES}


def document(rows: Mapping[str, Row]) -> str:
    """Return the document."""
    parts = [
        "# Protocol",
        "Written by `iphyre-jax analyse protocols`. One fixed policy, the best of five seeds on the basic games and "
        "their unseen layouts, and five protocols: mean reward over the forty games and, after ±, the standard "
        "deviation of what a single use of the protocol reports, over so many uses: that of few uses is rough. Rates "
        "never share a table.",
    ]
    for fps in sorted({int(row["fps"]) for row in rows.values()}):
        chosen = {name: rows[name] for name in POLICIES if name in rows and rows[name]["fps"] == fps}
        first = next(iter(chosen.values()))
        cells = [
            [title, str(score["repetitions"]), *(_cell(row["protocols"][title]) for row in chosen.values())]
            for title, score in first["protocols"].items()
        ]
        parts.append(f"## {fps} steps a second, reset {first['resets']}, {first['dtype']}")
        parts.append(markdown_table(["protocol", "uses", *chosen], cells))
    return "\n\n".join(parts) + "\n"


def _cell(scores: Mapping[str, float]) -> str:
    spread = f" ± {scores['spread']:.1f}" if scores["repetitions"] > 1 else ""
    return f"{scores['mean']:.1f}{spread}"
