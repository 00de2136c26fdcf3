"""`iphyre-jax analyse`: documents of what is there, and what is missing."""

from pathlib import Path

import pytest

from iphyre_jax.analyses import oracle
from iphyre_jax.cli.main import run
from iphyre_jax.kept_rows import kept_row


def test_documents_of_shipped_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = ["slack", "failures", "people", "within-template", "games", "claims"]
    assert run(["analyse", *made, "--out", str(tmp_path), "--rows", str(tmp_path / "none")]) == 0
    printed = capsys.readouterr().out.split()
    assert [Path(line).name for line in printed] == [f"{name}.md" for name in made]
    for name in made:
        text = (tmp_path / f"{name}.md").read_text()
        assert text.startswith("# ")
        assert "nan" not in text
        assert f"`iphyre-jax analyse {name}`" in text


def test_what_is_missing_is_said_and_not_computed(tmp_path: Path) -> None:
    (tmp_path / "rows" / "oracle-60fps").mkdir(parents=True)
    settings = oracle.settings(60)
    row = next(iter(oracle.shipped(60).values()))
    kept_row(tmp_path / "rows" / "oracle-60fps", "hole", settings, lambda: row)
    assert run(["analyse", "oracle", "--written-only", "--out", str(tmp_path), "--rows", str(tmp_path / "rows")]) == 0
    assert "Still missing" in (tmp_path / "oracle.md").read_text()


def test_documents_without_rows_stay_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = ["oracle", "difficulty", "protocols", "attempts", "imagination", "claims"]
    for name in made:
        (tmp_path / f"{name}.md").write_text("as it was")
    where = ["--out", str(tmp_path), "--rows", str(tmp_path / "none")]
    assert run(["analyse", *made, "--written-only", *where]) == 0
    assert capsys.readouterr().out.count("its document stays as it is") == len(made)
    assert {(tmp_path / f"{name}.md").read_text() for name in made} == {"as it was"}
    assert not (tmp_path / "none").exists()


def test_seeds_are_looked_for_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = ["--out", str(tmp_path), "--rows", str(tmp_path / "none"), "--runs", str(tmp_path / "runs")]
    assert run(["analyse", "people", "within-template", *where]) == 2
    assert "runs: expected" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert run(["analyse", "within-template", "--written-only", *where]) == 0
    assert "its document stays as it is" in capsys.readouterr().out


def test_unknown_analysis_is_a_mistake() -> None:
    assert run(["analyse", "weather"]) == 2
