"""A client's score against random play, and its record in build/clients/."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from iphyre_jax.files import replace_json
from iphyre_jax.provenance import CORE, device, processor, source_commit, versions
from iphyre_jax.rules import OFFICIAL_FPS

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


class Moment(NamedTuple):
    """A moment by two clocks."""

    wall: float  # s
    processor: float  # s, of this process and of those that it has waited for


def now() -> Moment:
    """Return this moment."""
    used = os.times()
    return Moment(time.monotonic(), used.user + used.system + used.children_user + used.children_system)


def leads(score: Score, random: Score) -> bool:
    """Return whether an agent is better than random play, beyond chance and by enough to matter."""
    return score.mean - random.mean > max(MARGIN, SURE * math.hypot(score.error, random.error))


def record(
    client: str,
    package: str,
    ran: str,
    *,
    since: Moment,
    score: Score | None = None,
    random: Score | None = None,
    seed: int = 0,
    fps: int = OFFICIAL_FPS,
) -> bool:
    """Write what a client did, print it in a line, and return whether it beat random play (if it trained).

    Args:
        client: its name, a slug.
        package: whose version is named.
        ran: what ran, one phrase.
        since: when it began; compilation counts.
        score: of the trained agent; None for a client that trains none.
        random: of random play in the same environment.
        seed: of the agent and its games.
        fps: of the environment.
    """
    good = score is None or random is None or leads(score, random)
    wall, used = (after - before for after, before in zip(now(), since, strict=True))
    content = {
        "client": client,
        "package": package,
        "version": version(package),
        "ran": ran,
        "seed": seed,
        "fps": fps,
        "seconds": round(wall, 1),
        "processor_seconds": round(used, 1),
        "score": None if score is None else asdict(score),
        "random": None if random is None else asdict(random),
        "passed": good,
        "versions": versions(CORE),
        "device": device(),
        "processor": processor(),
        "commit": source_commit(),
    }
    FOLDER.mkdir(parents=True, exist_ok=True)
    replace_json(FOLDER / f"{client}.json", content)
    against = f": {score.mean:.1f}, random {random.mean:.1f}" if score and random else ""
    verdict = "" if good else " - NOT BETTER"
    print(f"{client} {version(package)}: {ran}{against}, {wall:.0f} s, {used:.0f} of processor{verdict}", flush=True)
    return good


def leave(good: bool) -> None:
    """End the script: 0 if all went well, else 1."""
    sys.exit(0 if good else 1)
