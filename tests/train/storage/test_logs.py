"""Logs that go on where a run stopped, and means over seeds by hand."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.train import loop
from iphyre_jax.train.reports.statistics import summary
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import logs

COLUMNS = ("update", "reward", "greedy_reward")


def line(update: int) -> dict[str, Any]:
    return {"update": update, "reward": update / 3, "greedy_reward": None if update % 2 else 1.5}


def test_lines_after_the_checkpoint_are_written_again(tmp_path: Path) -> None:
    log = logs.Log(tmp_path, COLUMNS, 0, tensorboard=False)
    for update in (1, 2, 3):
        log.add(line(update))
    undisturbed = (tmp_path / logs.FILE).read_text()
    assert undisturbed == "update,reward,greedy_reward\n1,0.333333,\n2,0.666667,1.5\n3,1,\n"
    with (tmp_path / logs.FILE).open("a") as file:
        file.write("4,1.33")  # cut short by a kill
    assert len(logs.read(tmp_path)) == 3
    again = logs.Log(tmp_path, COLUMNS, 1, tensorboard=False)
    assert [entry["update"] for entry in logs.read(tmp_path)] == ["1"]
    for update in (2, 3):
        again.add(line(update))
    assert (tmp_path / logs.FILE).read_text() == undisturbed


def test_tensorboard_gets_what_was_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[tuple[Any, ...]] = []

    class Writer:
        def __init__(self, folder: str, purge_step: int) -> None:
            written.append((Path(folder).name, purge_step))

        def add_scalar(self, *scalar: Any) -> None:
            written.append(scalar)

        def flush(self) -> None:
            written.append(("flush",))

        def close(self) -> None:
            written.append(("close",))

    monkeypatch.setitem(sys.modules, "tensorboardX", SimpleNamespace(SummaryWriter=Writer))  # type: ignore[arg-type]
    log = logs.Log(tmp_path, COLUMNS, 4, tensorboard=True)
    log.add(line(5))
    log.close()
    assert written == [("tensorboard", 5), ("update", 5, 5), ("reward", 5 / 3, 5), ("flush",), ("close",)]


def test_a_missing_tensorboard_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^tensorboard: expected the extra 'tensorboard': pip install"):
        logs.Log(tmp_path, COLUMNS, 0, tensorboard=True)
    with pytest.raises(ValueError, match=r"^tensorboard: expected the extra"):
        loop.train(TrainConfig(tensorboard=True), tmp_path / "run", Console(quiet=True))
    assert not (tmp_path / "run").exists()  # so that the same command goes on without the option


def test_summary_by_hand() -> None:
    """Two seeds of four games: means 2.5 and 6.5; the middle half of 1 ... 8 is 3, 4, 5, 6."""
    found = summary([[1, 2, 3, 4], [5, 6, 7, 8]])
    assert (found.mean, found.iqm, found.seeds) == (4.5, 4.5, 2)
    assert found.high - found.mean == found.mean - found.low == pytest.approx(12.7062 * 2)  # Student's t, one degree
    assert summary([[1, 2], [1, 2]])[:3] == (1.5, 1.5, 1.5)
    alone = summary([[0, 0, 4, 100]])
    assert (alone.mean, alone.iqm) == (26.0, 2.0)
    assert math.isnan(alone.low)
    assert math.isnan(alone.high)


@pytest.mark.parametrize("seeds", [3, 5])
def test_the_interval_holds_the_mean_as_often_as_it_says(seeds: int) -> None:
    """A percentile bootstrap would hold it in 77 % (three seeds) or 84 % (five)."""
    rng = np.random.default_rng(0)
    found = [summary(rng.normal(100, 10, (seeds, 2)).tolist()) for _ in range(3000)]
    assert np.mean([one.low < 100 < one.high for one in found]) == pytest.approx(0.95, abs=0.015)
