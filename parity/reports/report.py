"""The report of a comparison as Markdown, as JSON and as a page."""

import json
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from iphyre_jax.provenance import CORE, processor, source_commit, versions
from parity.divergences import Astray
from parity.engines import reference
from parity.play import GameResult
from parity.reports.page import page
from parity.reports.tables import HEADINGS, LEGEND, Section, cells, headline, verdict_line
from parity.tolerances import SHARE_LIMITS

SCHEMA = 2  # of the JSON file


def markdown(made: Sequence[Section], results: Sequence[GameResult], around: Mapping[str, Any]) -> str:
    """The whole report as Markdown."""
    lines = ["# Ours against the reference engine", "", f"**{headline(made)}**", "", f"{LEGEND}.", ""]
    lines += [f"* {name}: {_inline(value)}" for name, value in around.items()]
    for section in made:
        rows = [cells(row) for row in (*section.games, section.overall, *section.sensitivity)]
        lines += ["", f"## {section.title}", "", verdict_line(section), ""]
        lines += ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
    astray = [plan for result in results for plan in result.astray if plan.dtype == "float64"]
    if astray:
        lines += ["", "## Plans that go astray in float64", ""]
        lines += [f"* {_told(plan)}" for plan in astray]
    return "\n".join(lines) + "\n"


def _told(plan: Astray) -> str:
    where = f"{plan.game}, {plan.fps} fps, plan {plan.plan} {list(plan.eliminate_at)}"
    first = f"; first bit: {plan.first_bit}" if plan.first_bit else ""
    stage = f"; first difference beyond its tolerance: {plan.first_stage}" if plan.first_stage else ""
    return f"{where}: {plan.error:.1e} px, steps {plan.ours[1]} and {plan.reference[1]}{first}{stage}"


def _inline(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_inline(inner)}" for name, inner in value.items())
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def circumstances(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a reader needs to repeat the run: versions, machine, commit and arguments."""
    return {
        "versions": {**versions(CORE), "pymunk": reference.VERSION},
        "machine": {"system": platform.platform(), "processor": processor(), "cores": os.cpu_count()},
        "xla flags": os.environ.get("XLA_FLAGS", "none"),
        "commit": source_commit() or "unknown",
        "arguments": dict(arguments),
    }


def as_json(made: Sequence[Section], results: Sequence[GameResult], around: Mapping[str, Any]) -> str:
    """The whole report as JSON, with the plans that went astray; infinite errors are written as null."""
    document = {
        "schema": SCHEMA,
        **around,
        "headline": headline(made),
        "share_limits_px": list(SHARE_LIMITS),
        "tables": [{**asdict(section), "verdict": verdict_line(section)} for section in made],
        "astray": [asdict(plan) for result in results for plan in result.astray],
    }
    return json.dumps(_finite(document), indent=1, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _finite(inner) for name, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, list | tuple) else value


def save(
    folder: Path,
    name: str,
    made: Sequence[Section],
    results: Sequence[GameResult],
    around: Mapping[str, Any],
    *,
    page_too: bool = True,
) -> None:
    """Write `name`.json, `name`.md and `name`.html into `folder`, which is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"json": as_json(made, results, around), "md": markdown(made, results, around)}
    if page_too:
        texts["html"] = page(made, results, around)
    for ending, text in texts.items():
        (folder / f"{name}.{ending}").write_text(text, encoding="utf-8")
