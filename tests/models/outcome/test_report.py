"""The report says what was measured, what is missing, and what the paper has."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax.cli import main as cli
from iphyre_jax.models.outcome import report, runs, storage
from iphyre_jax.models.storage import VERSION
from tests.models.outcome.made_up import made_up


def evaluation(*chances: float) -> dict[str, Any]:
    """Two seeds that give every plan the same chance."""
    plays = made_up(20, 0)
    table = np.repeat(np.array(chances)[:, None], len(plays), axis=1)
    found = runs.measured(plays, table, np.full(3, 0.25))
    return {
        "schema": storage.RUNS.schema,
        "version": VERSION,
        "row": "x",
        "parameters": 7,
        "columns": {"noisy": found},
    }


def test_measures_of_constant_judgements() -> None:
    solved = float(made_up(20, 0).success.mean())
    found = evaluation(0.9, 0.1)["columns"]["noisy"]
    assert found["accuracy"] == pytest.approx([solved, 1 - solved])
    assert found["recall_solved"] == [1.0, 0.0]
    assert found["auroc"] == [0.5, 0.5]
    assert found["natural constant"] == pytest.approx(0.75)
    assert sum(found["reliability"]["plans"]) == 2 * 60
    assert set(found["games"]) == {"support", "hinder", "hole"}


def test_document(tmp_path: Path) -> None:
    curve = [0.25, 0.3, 0.35, 0.4, 0.5]
    agents = {"random plans": [dict.fromkeys(("basic", "noisy", "compositional", "multi_ball"), curve)]}
    rows = {"paper-global": evaluation(0.9, 0.1)}
    report.write(tmp_path / "outcome.md", rows, agents, ["relations"], {"commit": "abc"})
    text = (tmp_path / "outcome.md").read_text()
    accuracy = report.cell(rows["paper-global"]["columns"]["noisy"]["accuracy"])
    assert f"| paper-global | 7 | - | - | - | - | - | {accuracy} | - | - |" in text
    assert "| paper: Global Fusion | - | 87.5 | - | - | - | - | 59.8 | 57.0 | 56.7 |" in text
    assert "Not trained yet: relations." in text
    assert "| random plans | 25 / 50 | 25 / 50 | 25 / 50 | 25 / 50 |" in text
    assert "## Noisy" in text
    assert "## Compositional" not in text  # nothing was judged there
    assert (tmp_path / "outcome-reliability.png").is_file()


def test_cells() -> None:
    assert report.cell([0.5]) == "50.0"
    assert report.cell([0.4, 0.6]) == "50.0 ± 14.1"
    assert report.cell([0.25, 0.25], 1.0, 3) == "0.250 ± 0.000"
    assert report.cell([float("nan")]) == "-"
    assert report.cell(None) == "-"


def test_a_mistake_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["classifier", "evaluate", str(tmp_path)]) == cli.ERROR
    assert "not a run folder, there is no config.json" in capsys.readouterr().err
    content = {"schema": storage.RUNS.schema, "version": VERSION, "row": "a"}
    (tmp_path / "evaluation.json").write_text(json.dumps(content))
    assert cli.run(["classifier", "evaluate", str(tmp_path)]) == cli.ERROR
    assert "evaluation.json: columns: expected a dict, got None" in capsys.readouterr().err
    assert cli.run(["classifier", "train", "nothing"]) == cli.ERROR
    assert capsys.readouterr().err.startswith("iphyre-jax: row: expected one of paper-global, ")
