"""What is published of the rows of the three documents of models: such a row is not trained again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.files import replace_json, replace_text
from iphyre_jax.models.outcome import compare as outcome
from iphyre_jax.models.outcome import storage as outcome_storage
from iphyre_jax.models.sequence import compare as sequence
from iphyre_jax.models.sequence import storage as sequence_storage
from iphyre_jax.models.storage import CONFIG, EVALUATION, METRICS, VERSION, Comparison
from iphyre_jax.models.world import compare as world
from iphyre_jax.models.world import storage as world_storage

QUIET = Console(quiet=True)


def _row(module: ModuleType, where: Comparison, config: Any) -> None:
    """Ask for a row, trained or not."""
    if module is world:
        world.publish_run(where, config, QUIET)
    elif module is outcome:
        outcome.published_row(where, config, np.zeros(0), QUIET)  # type: ignore[arg-type]  # plays are not looked at
    else:
        sequence.published_row(where, config, QUIET)


def _maker(module: ModuleType, storage: ModuleType, made: list[str]) -> dict[str, Callable[..., Any]]:
    """Functions that write a run folder without training anything, by the names that they replace."""

    def make(root: Path, config: Any, *_: object) -> dict[str, Any]:
        folder = root if module is world else root / config.name
        folder.mkdir(parents=True, exist_ok=True)
        settings = {"schema": storage.RUNS.schema, "version": VERSION, "settings": config.to_json()}
        evaluation = {**settings, "measures": storage.RUNS.measures}
        replace_json(folder / CONFIG, settings)
        replace_text(folder / METRICS, "step,loss\n")
        replace_json(folder / EVALUATION, evaluation)
        made.append(config.name)
        return evaluation

    return {"train": make, "evaluate": lambda *_: None} if module is world else {"make_row": make}


@pytest.mark.parametrize(
    ("module", "storage", "config"),
    [
        (outcome, outcome_storage, outcome.ROWS["paper-plan"]),
        (sequence, sequence_storage, sequence.ROWS["paper-in-advance"]),
        (world, world_storage, world.row_settings("objects-100", 1)),
    ],
    ids=["outcome", "sequence", "world"],
)
def test_a_published_row_is_trained_again_only_with_other_settings(
    module: ModuleType, storage: ModuleType, config: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    for name, function in _maker(module, storage, made).items():
        monkeypatch.setattr(module, name, function)
    where = Comparison(tmp_path / "build", tmp_path / "results" / "document.md")
    _row(module, where, config)
    assert made == [config.name]
    published = tmp_path / "results" / "models" / "document" / config.name
    assert sorted(file.name for file in published.iterdir()) == sorted([CONFIG, METRICS, EVALUATION])
    _row(module, where, config)
    assert made == [config.name]
    _row(module, where, dataclasses.replace(config, learning_rate=0.5))
    assert made == [config.name, config.name]
