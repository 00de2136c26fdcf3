"""Train the classifier that chooses among a policy's plans, on plays of the scenes that the policy may learn from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from iphyre_jax.models.outcome import runs, storage
from iphyre_jax.models.outcome.plays.pool import pool_plays
from iphyre_jax.models.outcome.plays.sets import compact
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import chosen
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import Scene

HELD: Final = 40  # one scene in so many is held out, to watch the training; nothing is chosen by it


def trained_ranker(
    folder: Path, generated: Sequence[Scene], config: OutcomeConfig, console: Console
) -> storage.OutcomeClassifier:
    """The ranker of a folder; what is missing is played and trained, or the rest of it.

    Args:
        folder: of plays, run and network; for these scenes and settings alone.
        generated: scenes to learn from, beside basic games and variations.
        config: settings with one seed.
        console: for progress.

    Raises:
        ValueError: one line; the folder holds another ranker, or a damaged one.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    if config.name not in storage.names(folder):
        plays = pool_plays(generated, config, folder / "plays", console)
        held = plays.game % HELD == 0
        learned, watched = compact(plays.select(~held)), runs.sampled(plays.select(held))
        state = runs.train(folder / "run", config, learned, watched, console)
        params = storage.rounded(chosen(config, state), 0)
        origin = {"seed": 0, "plays": len(learned), "scenes": len(learned.scenes), "trained": provenance()}
        storage.save_classifier(storage.OutcomeClassifier(config.name, config, params, origin), folder)
    ranker = storage.load_classifier(config.name, folder)
    if ranker.config != config:
        name = next(name for name, value in config.to_json().items() if ranker.config.to_json()[name] != value)
        raise ValueError(f"{folder}: {name}: expected that of these settings, found another; remove the folder")
    return ranker
