"""A client's score against random play, and its record in build/clients/."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from iphyre_jax.files import replace_json
from iphyre_jax.provenance import CORE, device, source_commit, versions

FOLDER = Path(__file__).parents[2] / "build" / "clients"
SURE = 3.0  # standard errors by which a trained agent must lead
MARGIN = 50.0  # points by which it must lead: where random play solves nearly all, a lead of chance would do


@dataclass(frozen=True)
class Score:
    """The mean reward of some episodes."""

    mean: float
    error: float  # standard error of the mean
    episodes: int

    @classmethod
    def of(cls, rewards: Sequence[float] | np.ndarray) -> Score:
        """Return the score of the episodes' rewards, any shape."""
        flat = np.asarray(rewards, np.float64).reshape(-1)
        return cls(float(flat.mean()), float(flat.std() / math.sqrt(flat.size)), int(flat.size))


def leads(score: Score, random: Score) -> bool:
    """Return whether an agent is better than random play, beyond chance and by enough to matter."""
    return score.mean - random.mean > max(MARGIN, SURE * math.hypot(score.error, random.error))


def record(
    client: str, package: str, ran: str, *, seconds: float, score: Score | None = None, random: Score | None = None
) -> bool:
    """Write what a client did, print it in a line, and return whether it beat random play (if it trained).

    Args:
        client: its name, a slug.
        package: whose version is named.
        ran: what ran, one phrase.
        seconds: that it took, with compilation.
        score: of the trained agent; None for a client that trains none.
        random: of random play in the same environment.
    """
    good = score is None or random is None or leads(score, random)
    content = {
        "client": client,
        "package": package,
        "version": version(package),
        "ran": ran,
        "seconds": round(seconds, 1),
        "score": None if score is None else asdict(score),
        "random": None if random is None else asdict(random),
        "passed": good,
        "provenance": {"versions": versions(CORE), "device": device(), "commit": source_commit()},
    }
    FOLDER.mkdir(parents=True, exist_ok=True)
    replace_json(FOLDER / f"{client}.json", content)
    against = f": {score.mean:.1f}, random {random.mean:.1f}" if score and random else ""
    print(f"{client} {version(package)}: {ran}{against}, {seconds:.0f} s{'' if good else ' - NOT BETTER'}", flush=True)
    return good


def leave(good: bool) -> None:
    """End the script: 0 if all went well, else 1."""
    sys.exit(0 if good else 1)
