"""`make test-faults`, at its end: docs/results/faults.md from the files of build/faults/."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from record import FOLDER

from iphyre_jax.files import read_json_object, replace_text
from iphyre_jax.train.reports.report import markdown_table

PAGE = Path(__file__).parents[2] / "docs" / "results" / "faults.md"
COLUMNS = ("tried", "survived", "lost", "seconds", "commit")
INTRODUCTION = """# Faults

Written by `make test-faults`, `make soak` and `make test-server`, whose scripts are in `tests/robustness/`. *Tried* is
the number of faults, *survived* of those after which all was as promised, *lost* of things that were told to be safe
and are gone. Each row names the commit that it was measured on.
[Threat model](../reference/threat-model.md) says what is promised and what is not."""


def row(found: Mapping[str, Any]) -> list[str]:
    """The cells of a check."""
    commit, _, changes = (found["commit"] or "unknown").partition("+")
    counts = [f"{found[name]:,}" for name in COLUMNS[:3]]
    commit = commit[:9] + ("+changes" if changes else "")
    return [f"`{found['check']}`: {found['promise']}", *counts, f"{found['seconds']:.0f}", commit]


def page(found: Sequence[Mapping[str, Any]]) -> str:
    """The document: what was tried, and on which machine."""
    machines = sorted({each["machine"] for each in found})
    on = f"Machine: {'; '.join(machines)}." if machines else "No check has run yet."
    table = markdown_table(["check", *COLUMNS], [row(each) for each in found])
    return "\n\n".join([INTRODUCTION, table, on]) + "\n"


def main() -> None:
    """Read every file, write the page."""
    found = [read_json_object(file) for file in sorted(FOLDER.glob("*.json"))]
    replace_text(PAGE, page(found))
    print(f"{PAGE.relative_to(PAGE.parents[2])}: {len(found)} checks")


if __name__ == "__main__":
    main()
