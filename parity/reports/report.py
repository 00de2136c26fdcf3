"""The report of a comparison as Markdown, as JSON and as a page."""

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from iphyre_jax.files import replace_text
from iphyre_jax.provenance import CORE, machine, source_commit, versions
from parity.divergences import DivergedPlan
from parity.engines import reference
from parity.play import GameResult
from parity.reports.page import page
from parity.reports.tables import HEADINGS, LEGEND, Section, cells, headline, inline, screen_table, targets_line
from parity.tolerances import SHARE_LIMITS

SCHEMA = 3  # of the JSON file


def markdown(tables: Sequence[Section], results: Sequence[GameResult], info: Mapping[str, Any]) -> str:
    """The whole report as Markdown."""
    lines = ["# Parity with pymunk", "", f"**{headline(tables)}**", "", f"{LEGEND}.", ""]
    lines += [f"* {name}: {inline(value)}" for name, value in info.items()]
    for section in tables:
        rows = [cells(row) for row in (*section.games, section.overall, *section.sensitivity)]
        lines += ["", f"## {section.title}", "", targets_line(section), ""]
        lines += ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
        lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    diverged = [plan for result in results for plan in result.diverged if plan.dtype == "float64"]
    if diverged:
        lines += ["", "## Plans that diverge in float64", ""]
        lines += [f"* {_described(plan)}" for plan in diverged]
    return "\n".join(lines) + "\n"


def _described(plan: DivergedPlan) -> str:
    where = f"{plan.game}, {plan.fps} fps, plan {plan.plan} {list(plan.eliminate_at)}"
    first = f"; first bit: {plan.first_bit}" if plan.first_bit else ""
    stage = f"; first stage beyond its tolerance: {plan.first_stage}" if plan.first_stage else ""
    return f"{where}: {plan.error:.1e} px, steps {plan.ours[1]} and {plan.reference[1]}{first}{stage}"


def run_info(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a reader needs to repeat the run: versions, machine, commit and arguments."""
    return {
        "versions": {**versions(CORE), "pymunk": reference.VERSION},
        "machine": machine(),
        "xla flags": os.environ.get("XLA_FLAGS", "none"),
        "commit": source_commit() or "unknown",
        "arguments": dict(arguments),
    }


def as_json(tables: Sequence[Section], results: Sequence[GameResult], info: Mapping[str, Any]) -> str:
    """The whole report as JSON, with the plans that diverge; an infinite error becomes null."""
    document = {
        "schema": SCHEMA,
        **info,
        "headline": headline(tables),
        "share_limits_px": list(SHARE_LIMITS),
        "tables": [{**asdict(section), "targets_met": targets_line(section)} for section in tables],
        "diverged": [asdict(plan) for result in results for plan in result.diverged],
    }
    return json.dumps(_finite(document), indent=1, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _finite(inner) for name, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, list | tuple) else value


def publish(
    folder: Path,
    name: str,
    tables: Sequence[Section],
    results: Sequence[GameResult],
    info: Mapping[str, Any],
    console: Console,
    *,
    with_page: bool = True,
) -> int:
    """Print the tables and write `name`.json, `name`.md and `name`.html into `folder`, created if missing.

    Returns:
        The exit code of the command: 0 if every target is met, else 1.
    """
    texts = {"json": as_json(tables, results, info), "md": markdown(tables, results, info)}
    if with_page:
        texts["html"] = page(tables, results, info)
    folder.mkdir(parents=True, exist_ok=True)
    for ending, text in texts.items():
        replace_text(folder / f"{name}.{ending}", text)
    for section in tables:
        console.print(screen_table(section))
    saved = f"saved {folder / name}: {', '.join(texts)}"
    for line in (LEGEND, *map(targets_line, tables), headline(tables), saved):
        console.print(line, highlight=False, soft_wrap=line is not LEGEND)
    return int(any(section.missed for section in tables))
