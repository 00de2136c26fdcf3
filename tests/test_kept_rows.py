from pathlib import Path

import pytest

from iphyre_jax.kept_rows import kept_row, read_rows, rows_there


def test_a_row_is_computed_once(tmp_path: Path) -> None:
    calls = []

    def compute() -> dict[str, float]:
        calls.append(1)
        return {"value": 1.5}

    for _ in range(2):
        assert kept_row(tmp_path / "new", "a", {"seed": 0}, compute) == {"value": 1.5}
    assert calls == [1]
    assert read_rows(tmp_path / "new") == {"a": {"value": 1.5}}
    assert read_rows(tmp_path / "none") == {}


def test_rows_of_other_settings_and_other_files_are_refused(tmp_path: Path) -> None:
    kept_row(tmp_path, "a", {"seed": 0}, lambda: {"value": 1})
    with pytest.raises(ValueError, match=r"a\.json: settings: expected others: seed 0, not 1; remove the file$"):
        kept_row(tmp_path, "a", {"seed": 1}, lambda: {"value": 1})
    assert rows_there(tmp_path, {"a": {"seed": 0}, "none": {}}) == {"a": {"value": 1}}
    with pytest.raises(ValueError, match="expected others: seed 0, not 1"):
        rows_there(tmp_path, {"a": {"seed": 1}})
    (tmp_path / "b.json").write_text('{"schema": "x"}')
    with pytest.raises(ValueError, match=r"b\.json: expected schema \"iphyre_jax/analysis-row\", version 1, got 'x'$"):
        read_rows(tmp_path)
    (tmp_path / "b.json").write_text('{"schema": "iphyre_jax/analysis-row", "version": 2}')
    with pytest.raises(ValueError, match=r"version 1, got version 2$"):
        read_rows(tmp_path)


def test_an_error_leaves_no_row(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        kept_row(tmp_path, "a", {}, lambda: {"value": 1 / 0})
    assert read_rows(tmp_path) == {}
