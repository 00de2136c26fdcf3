"""The report: rates apart, every mode of play, bounds beside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from iphyre_jax.models.sequence import evaluation, report
from iphyre_jax.models.sequence.settings import settings
from iphyre_jax.scenes import GAMES


def made_up(solved: float, seeds: int, episodes: int) -> dict[str, Any]:
    success = np.random.default_rng(0).random((seeds, len(evaluation.ALL_GAMES), episodes)) < solved
    return evaluation.result(1000.0 * success, success)


def test_result() -> None:
    reward = np.zeros((2, 50, 4))
    reward[:, 0] = [[0, 0, 1000, 1000], [1000, 1000, 1000, 1000]]  # support
    found = evaluation.result(reward, reward > 0)
    np.testing.assert_allclose(evaluation.split_means(found, "basic")[0], [50, 100])
    np.testing.assert_allclose(evaluation.split_means(found, "all")[1], [0.5 / 40, 1 / 40])
    variance = 1000**2 / 3  # of the first seed's four episodes
    np.testing.assert_allclose(found["standard error over episodes, all"], np.sqrt(variance / 4 / 4) / 40)


def test_writes(tmp_path: Path) -> None:
    found = {}
    for config in (settings("paper"), settings("paper", "on-the-fly")):
        modes = {"greedy": made_up(0.5, 2, 1), "sampled": made_up(0.1, 2, 5), "sweep": {"0.0": [1.0, 2.0]}}
        found[config.name] = {"settings": config.to_json(), "parameters": 7, "modes": modes}
    bounds = {60: {"doing nothing": made_up(0.0, 1, 1)}, 10: {"doing nothing": made_up(0.05, 1, 1)}}
    best = {60: {"all": (970.0, 1.0)}}
    report.write(tmp_path / "s.md", found, bounds, best, ["ours-in-advance"], {"seed": "0"})
    text = (tmp_path / "s.md").read_text()
    smooth, official = text.split("## 60 steps a second")[1].split("## 10 steps a second")
    assert "| paper-in-advance | greedy | 2 |" in smooth
    assert "paper-on-the-fly" not in smooth
    assert "| best known plans | - | - | - | - | - | - | - | 970.0 / 100 |" in smooth
    assert "| paper-on-the-fly | sampled | 2 |" in official
    assert "Not trained yet: ours-in-advance." in text
    assert "| paper-in-advance | 1 / 2 |" in text
    assert len(GAMES) == 40
