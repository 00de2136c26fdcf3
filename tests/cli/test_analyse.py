"""`iphyre-jax analyse`: documents of what is there, and what is missing."""

from pathlib import Path

import pytest

from iphyre_jax.cli.main import run


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
    made = ["oracle", "difficulty", "attempts"]
    where = ["--out", str(tmp_path), "--rows", str(tmp_path / "none")]
    assert run(["analyse", *made, "--written-only", *where]) == 0
    for name in made:
        assert "Still missing" in (tmp_path / f"{name}.md").read_text()
    assert not (tmp_path / "none").exists()


def test_unknown_analysis_is_a_mistake() -> None:
    assert run(["analyse", "weather"]) == 2
