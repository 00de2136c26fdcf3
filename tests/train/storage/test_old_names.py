"""Run folders, settings and options of the version before the present names: read, evaluated and resumed.

The two runs of data/ were written and interrupted by that version; the JSON files say what it made of them afterwards.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.cli import train
from iphyre_jax.train import loop
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.reports import compare
from iphyre_jax.train.settings import old_names
from iphyre_jax.train.settings.codec import config_from_json
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs, runs

DATA = Path(__file__).parent / "data"
GAMES = ("support", "hole")


def rewards(games: list[dict[str, Any]]) -> list[float]:
    return [game[kind]["reward"] for game in games for kind in ("greedy", "sampled")]


def numbers(lines: list[dict[str, str]]) -> list[list[float]]:
    return [[float(cell or 0) for name, cell in line.items() if "seconds" not in name] for line in lines]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", "ddpg"])
def test_an_old_run_is_evaluated_and_resumed(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "_same_versions", lambda path: None)  # other packages: close, not bit for bit
    expected = json.loads((DATA / f"{name}.json").read_text())
    with zipfile.ZipFile(DATA / f"{name}.zip") as archive:
        archive.extractall(tmp_path)
    folder = tmp_path / name
    config, state = runs.load(folder)
    found = evaluate(config, state.learner, GAMES).to_json()["games"]
    np.testing.assert_allclose(rewards(found), rewards(expected["evaluated"]), rtol=1e-4)
    assert set(compare.read(folder).games) == set(GAMES)
    if name == "ddpg":  # its replay buffer has rows that are no longer kept
        with pytest.raises(ValueError, match="its replay buffer is of an older form: it can be evaluated, not resumed"):
            loop.resume(folder, Console(quiet=True))
        return
    result = loop.resume(folder, Console(quiet=True))
    np.testing.assert_allclose(numbers(logs.read(folder)), numbers(expected["metrics"]), rtol=1e-3, atol=1e-6)
    found = evaluate(config, result.state.learner, GAMES).to_json()["games"]
    np.testing.assert_allclose(rewards(found), rewards(expected["resumed"]), rtol=1e-4)
    assert int(runs.load(folder)[1].update) == 3


def test_old_settings_are_read_under_their_present_names() -> None:
    learner = {"clip": 0.3, "rows": 64, "minibatches": 2, "normalise": "batch", "trace": 0.9, "entropy": 0.0}
    old = {"head": "slots", "network": "perceptron", "centred": False, "hidden": [8], "learner": learner}
    config = config_from_json(old, "run", old=True)
    assert (config.head, config.network, config.center_obs, config.hidden_sizes) == ("time_grid", "mlp", False, (8,))
    assert config.learner.clip_eps == 0.3  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="unknown setting 'clip'"):
        config_from_json({"learner": learner}, "run")
    present = {*TrainConfig().to_json(), *TrainConfig().to_json()["learner"]}
    assert not present & set(old_names.SETTINGS)


def test_old_options_work_and_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    old = ["--hidden", "8", "--no-centred", "--head=slots", "--network", "perceptron", "--rows=64", "--seed", "1"]
    new = ["--hidden-sizes", "8", "--no-center-obs", "--head=time_grid", "--network", "mlp", "--samples-per-update=64"]
    assert train.renamed(old) == [*new, "--seed", "1"]
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "DeprecationWarning: --hidden is now --hidden-sizes; the next version drops the old name"
    assert len(said) == 5
    assert train.renamed(new) == new
