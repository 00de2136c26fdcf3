"""Writes docs/results/clients.md from the records in build/clients/."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from score import FOLDER, MARGIN, SURE

from iphyre_jax.files import read_json_object, replace_text

PAGE = Path(__file__).parents[2] / "docs" / "results" / "clients.md"
HEAD = f"""# Clients

Trainers and libraries that run over the environments as they are, in versions of their own (`tests/clients/`).
`make test-clients` runs all of them and writes this page. An agent trains on one game, about a minute of an idle
machine. It must lead random play by {MARGIN:g} points and by {SURE:g} standard errors. Scores are mean rewards of
sampled episodes, ± one standard error.

| client | version | what ran | score | random | s |
|---|---|---|---|---|---|
"""


def row(content: dict[str, Any]) -> str:
    """Return a record as a row of the table."""
    score, random = (
        f"{part['mean']:.1f} ± {part['error']:.1f}" if part else "-" for part in (content["score"], content["random"])
    )
    name = content["client"] if content["passed"] else f"{content['client']} (failed)"
    package = f"{content['package']} {content['version']}"
    return f"| {name} | {package} | {content['ran']} | {score} | {random} | {content['seconds']:.0f} |"


def main() -> None:
    """Write the page."""
    records = [read_json_object(path) for path in sorted(FOLDER.glob("*.json"))]
    if not records:
        raise SystemExit(f"{FOLDER}: expected records, got none")
    runs = sorted({f"{r['provenance'].get('commit', '?')}" for r in records})
    replace_text(PAGE, HEAD + "\n".join(map(row, records)) + f"\n\nCommits: {', '.join(runs)}.\n")


if __name__ == "__main__":
    main()
