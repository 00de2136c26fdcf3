"""The tables of a comparison, for the screen, as Markdown and as JSON."""

import json
import math
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from parity import reference
from parity.compare import Summary, summarise
from parity.play import GameResult
from parity.tolerances import SHARE_LIMITS, TARGETS
from parity.verdict import missed_targets

SCHEMA = 1  # of the JSON file
HEADINGS = (
    "game",
    "plans",
    "solved",
    "max px",
    *(f"{limit:.0e}".replace("e-0", "e-").replace("1e+00", "1 px") for limit in SHARE_LIMITS),
    "flag",
    "step",
    "flag*",
    "step*",
    "faults",
)
LEGEND = (
    "max px: largest error in play; 1e-9 to 1 px: % of plans within it; flag, step: % of plans with the same success "
    "flag and step, * of those that the reference solves"
)


@dataclass(frozen=True)
class Section:
    """All games at one frame rate and in one type.

    Attributes:
        fps: physics steps a second.
        dtype: the type ours ran in.
        games: one row a game.
        overall: the row of all games together.
        missed: the targets that are missed, one sentence each.
    """

    fps: int
    dtype: str
    games: tuple[Summary, ...]
    overall: Summary
    missed: tuple[str, ...]

    @property
    def title(self) -> str:
        """The rate and the type in words."""
        return f"{self.fps} fps, {self.dtype}"


def sections(results: Sequence[GameResult]) -> list[Section]:
    """Sort the results of all games into one section for each frame rate and type, in order of appearance."""
    made = []
    for fps, dtype in dict.fromkeys((result.fps, result.dtype) for result in results):
        chosen = [result for result in results if (result.fps, result.dtype) == (fps, dtype)]
        games = tuple(summarise(result.game, [result.comparison]) for result in chosen)
        overall = summarise("all", [result.comparison for result in chosen])
        made.append(Section(fps, dtype, games, overall, tuple(missed_targets(fps, dtype, games, overall))))
    return made


def cells(row: Summary) -> tuple[str, ...]:
    """One row as text, in the order of `HEADINGS`."""
    return (
        row.name,
        str(row.plans),
        str(row.solved),
        f"{row.max_error:.1e}",
        *(_percent(share) for share in row.shares),
        _percent(row.same_flag),
        _percent(row.same_step),
        _percent(row.same_flag_solved),
        _percent(row.same_step_solved),
        str(row.faults),
    )


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.4g}"


def screen_table(section: Section) -> Table:
    """The section as a table for the terminal."""
    table = Table(
        title=f"Ours against pymunk {reference.VERSION}, {section.title}", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading == "game" else "right", no_wrap=heading == "game")
    for row in section.games:
        table.add_row(*cells(row))
    table.add_section()
    table.add_row(*cells(section.overall), style="bold")
    return table


def verdict_line(section: Section) -> str:
    """One line: the targets are reached, or which are not."""
    if not section.missed:
        return f"{section.title}: every target is reached"
    return f"{section.title}: MISSED: " + "; ".join(section.missed)


def markdown(made: Sequence[Section], around: Mapping[str, Any]) -> str:
    """The whole report as Markdown."""
    lines = ["# Ours against the reference engine", "", f"{LEGEND}.", ""]
    lines += [f"* {name}: {_inline(value)}" for name, value in around.items()]
    for section in made:
        rows = [cells(row) for row in (*section.games, section.overall)]
        lines += ["", f"## {section.title}", "", verdict_line(section), ""]
        lines += ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _inline(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_inline(inner)}" for name, inner in value.items())
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def circumstances(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """What a reader needs to repeat the run: versions, machine, commit and arguments."""
    names = ("jax", "jaxlib", "numpy")
    return {
        "versions": {
            "python": platform.python_version(),
            "pymunk": reference.VERSION,
            **{n: version(n) for n in names},
        },
        "machine": {"system": platform.platform(), "cores": os.cpu_count()},
        "xla flags": os.environ.get("XLA_FLAGS", "none"),
        "commit": _commit(),
        "arguments": dict(arguments),
    }


def _commit() -> str:
    """The checked-out commit, marked where tracked files differ from it; "unknown" outside a repository."""
    git = shutil.which("git")
    if git is None:
        return "unknown"
    command = [git, "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own fixed words
    return done.stdout.strip() or "unknown"


def misses(result: GameResult) -> list[dict[str, Any]]:
    """The plans of one result that end differently or stray further than their target's limit."""
    c = result.comparison
    limit = TARGETS[result.dtype, result.fps].error
    worth = ~((c.error <= limit) & c.same_step & c.same_eliminations & c.same_presence)
    return [
        {
            "plan": int(i),
            "eliminate_at": result.eliminate_at[i].tolist(),
            "error": float(c.error[i]),
            "reference": {"success": bool(c.reference_success[i]), "steps": int(c.reference_steps[i])},
            "ours": {"success": bool(c.success[i]), "steps": int(c.steps[i]), "fault": int(c.fault[i])},
            "same_eliminations": bool(c.same_eliminations[i]),
            "same_presence": bool(c.same_presence[i]),
        }
        for i in np.flatnonzero(worth)
    ]


def as_json(made: Sequence[Section], results: Sequence[GameResult], around: Mapping[str, Any]) -> str:
    """The whole report as JSON, with the plans that went astray; infinite errors are written as null."""
    document = {
        "schema": SCHEMA,
        **around,
        "share_limits_px": list(SHARE_LIMITS),
        "tables": [{**asdict(section), "verdict": verdict_line(section)} for section in made],
        "misses": [
            {"game": r.game, "fps": r.fps, "dtype": r.dtype, "plans": astray} for r in results if (astray := misses(r))
        ],
    }
    return json.dumps(_finite(document), indent=1, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _finite(inner) for name, inner in value.items()}
    return [_finite(inner) for inner in value] if isinstance(value, list | tuple) else value


def save(
    folder: Path, name: str, made: Sequence[Section], results: Sequence[GameResult], around: Mapping[str, Any]
) -> None:
    """Write `name`.json and `name`.md into `folder`, which is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(as_json(made, results, around), encoding="utf-8")
    (folder / f"{name}.md").write_text(markdown(made, around), encoding="utf-8")
