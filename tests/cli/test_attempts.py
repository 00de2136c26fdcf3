"""`iphyre-jax evaluate RUN --attempts`: the measures by split."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax import GAMES
from iphyre_jax.attempts.protocol import Attempts
from iphyre_jax.cli import train
from iphyre_jax.files import read_json_object
from iphyre_jax.train.settings.run import TrainConfig


def test_attempts_are_counted_by_split(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def tried(config: TrainConfig, learner: Any, k: int, **options: Any) -> Attempts:
        assert (options["fps"], options["resets"], options["greedy_first"]) == (config.fps, config.resets, True)
        shape = (len(options["games"]), options["runs"], k)
        success = np.zeros(shape, bool)
        success[:10, :, 0] = True  # basic: at once; all others at the second attempt
        success[10:, :, 1] = True
        zeros = np.zeros(shape)
        return Attempts(tuple(options["games"]), success, 970.0 * success, zeros.astype(int), zeros, 0)

    monkeypatch.setattr(train, "policy_attempts", tried)
    state: Any = SimpleNamespace(learner=None)
    train._print_attempts(TrainConfig(), state, GAMES, 2, Console(width=120))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["Basic", "100.0", "100.0", "100.0", "970.0"] in lines
    assert ["Noisy", "0.0", "100.0", "36.9", "970.0"] in lines  # 1 - ln 2 / ln 3
    assert ["All", "40", "25.0", "100.0", "52.7", "970.0"] in lines


def test_an_ensemble_is_written_beside_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train, "GAMES", ("support",))
    folders = [tmp_path / name for name in ("one", "two")]
    for seed, folder in enumerate(folders):
        config = TrainConfig(games=("support",), updates=1, hidden_sizes=(8,), sampled_episodes=1, seed=seed)
        assert train.run(train.Train(config, folder), Console(width=120)) == 0
    alone = (folders[0] / "evaluation.json").read_bytes()
    capsys.readouterr()
    with pytest.raises(ValueError, match=r"^ensemble: expected runs of different seeds, got 0, 0$"):
        train.run(train.Evaluate(folders[0], ensemble=(folders[0],)), Console(width=120))
    assert train.run(train.Evaluate(folders[0], ensemble=(folders[1],)), Console(width=120)) == 0
    assert str(folders[0] / "ensemble.md") in capsys.readouterr().out.replace("\n", "")
    content = read_json_object(folders[0] / "ensemble.json")
    assert content["ensemble of"] == "one, two"
    assert content["schema"] == "iphyre_jax/evaluation"
    assert "| ensemble of | one, two |" in (folders[0] / "ensemble.md").read_text()
    assert (folders[0] / "evaluation.json").read_bytes() == alone


def test_a_number_of_attempts_is_refused_before_anything_is_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = TrainConfig(), SimpleNamespace(learner=None)
    monkeypatch.setattr(train.runs, "load", lambda run, checkpoint: loaded)
    with pytest.raises(ValueError, match=r"^attempts: expected a whole number of at least 1 and at most 10000, got 0$"):
        train.run(train.Evaluate(tmp_path, attempts=0), Console())
