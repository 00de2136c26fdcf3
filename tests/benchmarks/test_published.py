"""What is published of runs, docs/results/runs/ and docs/results/carry-over/, gives the tables that stand beside it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks.learning import agents, carry_over, on_the_fly
from benchmarks.learning.rows import TableName, rows
from iphyre_jax.files import read_versioned
from iphyre_jax.kept_rows import SCHEMA, VERSION, read_row
from iphyre_jax.train.storage.pretrained import load_pretrained

RESULTS = Path(__file__).parents[2] / "docs" / "results"


def tables(file: Path) -> list[str]:
    """The lines of a document's tables."""
    return [line for line in file.read_text("utf-8").splitlines() if line.startswith("|")]


@pytest.mark.slow
@pytest.mark.parametrize(("table", "seeds"), [("default", 5), ("paper", 5), ("controllers", 3)])
def test_documents_of_agents(table: TableName, seeds: int, tmp_path: Path) -> None:
    arguments = agents.Arguments(out=tmp_path, table=table, seeds=seeds)
    arguments.published.symlink_to(RESULTS / "runs")
    agents.write(arguments, rows(table))
    written = tables(tmp_path / f"{arguments.stem}.md")
    assert len(written) > 20
    assert written == tables(RESULTS / f"{arguments.stem}.md")


def test_document_of_what_carries_over(tmp_path: Path) -> None:
    arguments = carry_over.Arguments(out=tmp_path)
    shutil.copy(RESULTS / carry_over.COUNTER, tmp_path)
    arguments.rows.symlink_to(RESULTS / "carry-over")
    carry_over._write(arguments, dict.fromkeys(("seed", "scenes", "protocol", "nearest_px")))
    written = tables(tmp_path / "carry-over.md")
    assert len(written) > 100
    assert written == tables(RESULTS / "carry-over.md")


@pytest.mark.parametrize("fps", [10, 60])
def test_rows_of_the_shipped_policy_are_those_of_its_weights(fps: int) -> None:
    for name, policy in carry_over._shipped(fps).items():
        read_row(RESULTS / "carry-over" / f"held-out-{fps}fps" / f"{name}.json", policy.settings())
        forty = read_versioned(RESULTS / "carry-over" / f"forty-{fps}fps" / f"{name}.json", SCHEMA, (VERSION,))
        assert policy.settings().items() <= forty["settings"].items()
    ranked = policy.settings()
    assert ranked["sha256"] != ranked["ranker_sha256"]


def test_seeds_of_agents_on_the_fly() -> None:
    written = [line for line in on_the_fly._seeds(RESULTS / "runs").splitlines() if line.startswith("|")]
    assert len(written) == 2 + len(on_the_fly.POLICIES)
    assert set(written) <= set(tables(RESULTS / "on-the-fly.md"))


def test_forty_games_of_agents_on_the_fly() -> None:
    policies = [load_pretrained(name) for name in on_the_fly.POLICIES]
    played = on_the_fly.runs_in(RESULTS / on_the_fly.COUNTER)
    assert played >= 1
    assert on_the_fly.forty(policies, played) in (RESULTS / "on-the-fly.md").read_text()
