"""What is measured on a GPU, tried on a CPU."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import iphyre_jax
from benchmarks import accelerator
from benchmarks.accelerator import Options
from iphyre_jax.train.settings.run import preset

pytestmark = pytest.mark.usefixtures("few_optimisations")


def test_a_cpu_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert accelerator.main([]) == 2
    assert capsys.readouterr().err == "expected a GPU: JAX's first device is a CPU\n"
    assert accelerator.main(["--plans", "0"]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--games", "hol"], "scene: expected the name of a game"),
        (["--splits", "nosuch"], "splits: expected one of "),
        (["--lanes", "0"], "lanes: expected a whole number of at least 1, got 0"),
        (["--worlds", "8", "-1"], "worlds: expected a whole number of at least 1, got -1"),
    ],
)
def test_bad_options_are_told_before_anything_is_measured(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accelerator, "on_cpu", lambda: False)
    monkeypatch.setattr(accelerator, "TABLES", {})
    assert accelerator.main(arguments) == 2
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.slow
def test_steps_and_decisions_are_told_row_by_row(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accelerator, "on_cpu", lambda: False)
    few = ["--parts", "steps", "decisions", "--games", "hole", "--lanes", "32", "--splits", "hole", "--worlds", "4"]
    assert accelerator.main(few) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| hole")]
    cells = [row.strip("| ").split(" | ") for row in rows]
    assert [row[1] for row in cells] == ["32", "32", "4"]
    assert all(float(number) >= 0 for row in cells for number in row[-2:])


def test_a_row_is_printed_before_the_next_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(options: Options) -> Iterator[tuple[str, ...]]:
        yield ("worlds",)
        yield (str(options.plans),)
        raise KeyboardInterrupt

    monkeypatch.setattr(accelerator, "on_cpu", lambda: False)
    monkeypatch.setitem(accelerator.TABLES, "steps", killed)
    with pytest.raises(KeyboardInterrupt):
        accelerator.main(["--parts", "steps", "--plans", "7"])
    assert capsys.readouterr().out.endswith("| worlds |\n| --- |\n| 7 |\n")


@pytest.mark.slow
@pytest.mark.further
def test_agents_are_trained_and_unknown_ones_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert accelerator.main(["--parts", "training", "--agents", "ppo"]) == 2
    assert capsys.readouterr().err.startswith("agents: expected one of ")
    short = replace(preset(name="quick"), updates=2, episodes_per_scene=8, games=("support",))
    monkeypatch.setattr(accelerator, "agent_rows", lambda: {"ppo-i": short})
    names, row = accelerator.training(Options(agents=("ppo-i",)))
    assert dict(zip(names, row, strict=True))["updates"] == "2"
    assert [float(number) > 0 for number in (row[1], row[3])] == [True, True]
    assert float(row[4]) >= float(row[1])
    assert -50 < float(row[5]) < 1000


def test_agreement_is_counted_play_by_play(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each game two plays: on the GPU all outcomes of the second game differ, and one ball of the last by 1/4 px."""
    games = len(iphyre_jax.GAMES)

    def played(platform: str, dtype: str, options: Options) -> tuple[Any, Any]:
        outcomes = np.zeros((games * options.plans, 4), int)
        poses = np.full((games * options.plans, 12, 3), 100.0)
        poses[:, 11] = np.nan
        if platform != "cpu":
            outcomes[1::games, 2] = 1
            poses[-1, 0, 1] += 0.25
        return outcomes, poses

    monkeypatch.setattr(accelerator, "played", played)
    rows = list(accelerator.agreement(Options(plans=2)))[1:4]
    assert rows[0] == ("float64", "all forty", "78 of 80", "79 of 80", "0.0e+00", "2.5e-01")
    assert [row[1] for row in rows[1:]] == ["balls alone move", "bars move"]
    assert sum(int(row[3].split()[2]) for row in rows[1:]) == 2 * games


def test_steps_are_counted() -> None:
    play, given = accelerator.batch_of(iphyre_jax.load_scene("hole"), 32, 10, "operations")
    assert 32 < accelerator.steps_made(play(*given)) <= 32 * 150
