"""The document of agents, from runs with made-up scores."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.learning import agents, agents_document, carry_over
from benchmarks.learning import rows as tables
from iphyre_jax.train.reports import compare
from parity import command
from tests.train.reports.test_compare import run


def test_what_a_prediction_adds() -> None:
    table = tables.controllers()
    scores = {"ppo-o-none": (500.0, 540.0), "ppo-o-perfect": (600.0, 620.0), "sac-c-zeros": (100.0,)}
    played = [
        run(dataclasses.replace(table[name], prediction_sha256="0" * 64 if "perfect" in name else ""), seed, reward)
        for name, rewards in scores.items()
        for seed, reward in enumerate(rewards)
    ]
    text, basic, forty = agents_document._added(agents_document.with_predictions(compare.rows(played)))
    assert "less that of the same agent and seeds" in text
    for part in (basic, forty):
        lines = [line.strip("| ").split(" | ") for line in part.splitlines()]
        assert lines[0][1:] == list(tables.PREDICTIONS)
        rows = {line[0]: line[1:] for line in lines[2:]}
        assert rows["PPO-O"] == ["520.0", "-", "-", "-", "-", "+90.0 [-37, +217]", "-"]
        assert rows["SAC-C"] == ["-"] * 7  # without the row to compare with there is no difference


def test_other_tables_have_no_predictions() -> None:
    config = tables.rows("default")["ppo-c"]
    assert agents_document.with_predictions(compare.rows([run(config, 0, 1.0)])) == {}


def test_a_seed_that_never_arrives_is_later_than_all_others() -> None:
    never = float("inf")
    times = [[33.1, never, 70.2, 39.3, never], [13.3, never, never, never, never], [never, never], [2.0, 4.0], []]
    expected = ["70.2 (3 of 5 seeds)", "never (1 of 5 seeds)", "never (0 of 2 seeds)", "3.0 (2 of 2 seeds)", "-"]
    assert [agents_document._median_time(reached) for reached in times] == expected


@pytest.mark.parametrize("module", [agents, carry_over])
def test_no_seeds_are_one_line_before_anything_is_written(
    module: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["command", "--seeds", "0", "--out", str(tmp_path / "out")])
    assert command.run(module.main, module.Arguments) == 2
    assert capsys.readouterr().err == "seeds: expected a whole number of at least 1, got 0\n"
    assert not (tmp_path / "out").exists()


def test_an_interrupt_of_a_command_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(arguments: agents.Arguments) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "argv", ["command"])
    assert command.run(interrupted, agents.Arguments) == 130
    assert capsys.readouterr().err == "interrupted; the same command goes on\n"
