"""Writes docs/results/clients.md from the records in build/clients/."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from score import FOLDER, MARGIN, SURE

from iphyre_jax.files import read_json_object, replace_text

PAGE = Path(__file__).parents[2] / "docs" / "results" / "clients.md"
HEAD = f"""# Clients

Trainers and libraries of others that run over the environments as they are, in the versions of `tests/clients/*.txt`.
Written by `make test-clients`. An agent trains on one game, where nothing else is said. It must lead random play by
{MARGIN:g} points and by {SURE:g} standard errors. Scores are mean rewards of sampled episodes, ± one standard error.
*s* is processor time, compilation included.
[Other libraries](../guide/clients/index.md) has the lines to copy.

| client | version | what ran | score | random | seed | fps | s | commit |
|---|---|---|---:|---:|---:|---:|---:|---|
"""


def row(content: dict[str, Any]) -> str:
    """Return a record as a row of the table."""
    score, random = (
        f"{part['mean']:.1f} ± {part['error']:.1f}" if part else "-" for part in (content["score"], content["random"])
    )
    seed = content["seed"] if content["score"] else "-"
    name = content["client"] if content["passed"] else f"{content['client']} (failed)"
    commit, _, changes = (content["commit"] or "unknown").partition("+")
    cells = [
        name,
        f"{content['package']} {content['version']}",
        content["ran"],
        score,
        random,
        seed,
        content["fps"],
        f"{content['processor_seconds']:.0f}",
        commit[:9] + ("+changes" if changes else ""),
    ]
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    """Write the page."""
    records = [read_json_object(path) for path in sorted(FOLDER.glob("*.json"))]
    if not records:
        raise SystemExit(f"{FOLDER}: expected records, got none")
    packages = sorted({f"{name} {version}" for each in records for name, version in each["versions"].items()})
    machines = sorted({f"{each['device']}, {each['processor']}" for each in records})
    foot = f"Versions: {', '.join(packages)}. Machine: {'; '.join(machines)}."
    replace_text(PAGE, HEAD + "\n".join(map(row, records)) + f"\n\n{foot}\n")


if __name__ == "__main__":
    main()
