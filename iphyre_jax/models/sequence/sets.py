"""The plays that rows learn from: basic games and their variations, never another split."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from iphyre_jax.data import collect
from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.labels import label_plans
from iphyre_jax.files import pack_npz, read_npz, replace_bytes, replace_json
from iphyre_jax.models.outcome.plays.augmented import kept_plays
from iphyre_jax.models.outcome.plays.sets import OF_A_KIND, compact, learned_plays, play_sets
from iphyre_jax.models.outcome.storage import plays_sum
from iphyre_jax.models.sequence.decisions import with_poses
from iphyre_jax.models.sequence.episodes import SequenceData, episodes
from iphyre_jax.models.sequence.settings import SequenceConfig
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.scenes import SPLITS

FEWER: Final = 16  # with states on the way, of the large set one variation in so many
MAX_EPISODES: Final = 2**32  # bytes
SUM: Final = "sum"  # SHA-256 of the plays, as an array beside those of the episodes


def official_plays(config: SequenceConfig, folder: Path, console: Console) -> Dataset:
    """50 solving and 50 failing plays of each basic game at the rate of a row: the paper's data."""
    if config.fps != OFFICIAL_FPS:
        return learned_plays(play_sets(folder, console), "official", folder, console)
    protocol = config.protocol
    title = f"collecting {OF_A_KIND} + {OF_A_KIND} plans of each basic game at {OFFICIAL_FPS} steps a second"
    draw = partial(
        collect,
        SPLITS["basic"],
        successes=OF_A_KIND,
        failures=OF_A_KIND,
        fps=protocol.fps,
        rule=protocol.rule,
        resets=protocol.resets,
    )
    return kept_plays(folder, f"basic-{OFFICIAL_FPS}fps", title, draw, console)


def large_plays(config: SequenceConfig, folder: Path, console: Console) -> Dataset:
    """Thousands of plays of each basic game, and of its variations; with states on the way fewer variations."""
    plays = learned_plays(play_sets(folder, console), "large", folder, console)
    if config.strategy == "in-advance":
        return plays
    basic = np.array([scene.name in SPLITS["basic"] for scene in plays.scenes])[plays.game]
    plays = compact(plays.select(basic | (plays.game % FEWER == 0)))
    return plays if config.fps == plays.fps else replayed(plays, config)


def replayed(plays: Dataset, config: SequenceConfig) -> Dataset:
    """The same plans at the rate of a row."""
    protocol = config.protocol
    steps = protocol.steps(np.asarray(plays.times, np.float64))
    labels = label_plans(plays.scenes, plays.game, steps, protocol)
    played = {"fps": protocol.fps, "rule": protocol.rule, "frames": protocol.frames, "resets": protocol.resets}
    return dataclasses.replace(
        plays,
        steps=steps.astype(np.int16),
        success=labels.success,
        end_step=labels.end_step,
        removals=labels.removals,
        manifest={**plays.manifest, **played},
    )


def learned_episodes(config: SequenceConfig, folder: Path, console: Console) -> tuple[SequenceData, dict[str, Any]]:
    """What a row learns from, kept in a file beside the plays; and the number and the sum of the plays.

    Args:
        config: settings of the row.
        folder: that keeps data sets.
        console: for progress.
    """
    names = ("preset", "strategy", "data", "fps", "solved_share", "coded_labels")
    decisive = {name: getattr(config, name) for name in names}
    digits = hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:8]
    file = folder / f"episodes-{config.name}-{digits}.npz"
    if not file.is_file():
        console.print(f"{config.name}: making sequences")
        plays = (large_plays if config.data == "large" else official_plays)(config, folder, console)
        if config.strategy != "in-advance":
            plays = with_poses(plays, config.protocol)
        made = episodes(plays, config)
        digest = np.frombuffer(bytes.fromhex(plays_sum(plays)), np.uint8)
        folder.mkdir(parents=True, exist_ok=True)
        replace_bytes(file, pack_npz({**made._asdict(), SUM: digest}))
        replace_json(file.with_suffix(".json"), {**decisive, "plays": len(plays), "sha256": digest.tobytes().hex()})
    arrays = read_npz(file, MAX_EPISODES)
    digest = arrays.pop(SUM)
    return SequenceData(**arrays), {"count": len(arrays["scene"]), "sha256": digest.tobytes().hex()}
