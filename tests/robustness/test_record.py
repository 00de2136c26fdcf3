"""The files of the fault scripts and the page that is made of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


def test_a_record_becomes_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))  # as for a script
    import record
    import report

    assert Path(__file__).parents[2] / "build" / "faults" == report.FOLDER
    monkeypatch.setattr(record, "FOLDER", tmp_path / "faults")
    record.record("attempts-cut", "no confirmed attempt is lost", 1200, 1199, 1, 12.3)
    assert capsys.readouterr().out == "attempts-cut: tried 1200, survived 1199, lost 1\n"
    found = json.loads((tmp_path / "faults" / "attempts-cut.json").read_text())
    assert (found["seconds"], found["versions"]["python"][:2]) == (12.3, "3.")
    found["commit"] = "0123456789abcdef+changes"
    expected = "| `attempts-cut`: no confirmed attempt is lost | 1,200 | 1,199 | 1 | 12 | 012345678+changes |\n"
    assert expected in report.page([found])
    for wrong in (("Attempts", 1, 1), ("attempts", 0, 0), ("attempts", 1, 2)):
        with pytest.raises(ValueError, match="expected"):
            record.record(wrong[0], "-", wrong[1], wrong[2], 0, 1.0)
