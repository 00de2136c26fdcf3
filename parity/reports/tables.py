"""The tables of a comparison: one for each frame rate and type, with one row a game."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table

from parity.engines import reference
from parity.play import GameResult
from parity.reports.summary import Summary, summarise
from parity.reports.targets_met import missed_targets
from parity.tolerances import SHARE_LIMITS

HEADINGS = (
    "game",
    "plans",
    "solved",
    "max px",
    "bits",
    *(f"{limit:.0e}".replace("e-0", "e-").replace("1e+00", "1 px") for limit in SHARE_LIMITS),
    "flag",
    "step",
    "flag*",
    "step*",
    "faults",
)
LEGEND = (
    "max px: largest error in play; bits: % of plans with every pose equal bit for bit; 1e-9 to 1 px: % of plans with "
    "no larger error; flag, step: % of plans with the same success flag and step; flag*, step*: the same, of the plans "
    "that pymunk solves"
)


@dataclass(frozen=True)
class Section:
    """All games at one frame rate and in one type.

    Attributes:
        fps: physics steps a second.
        dtype: the type ours ran in.
        games: one row a game.
        overall: the row of all games together.
        sensitivity: rows of the reference under slightly different gravity against itself, all games together.
        missed: one sentence for each target that is missed.
    """

    fps: int
    dtype: str
    games: tuple[Summary, ...]
    overall: Summary
    sensitivity: tuple[Summary, ...]
    missed: tuple[str, ...]

    @property
    def title(self) -> str:
        """The rate and the type in words."""
        return f"{self.fps} fps, {self.dtype}"


def sections(results: Sequence[GameResult]) -> list[Section]:
    """One section for each frame rate and type, in order of appearance."""
    tables = []
    for fps, dtype in dict.fromkeys((result.fps, result.dtype) for result in results):
        chosen = [result for result in results if (result.fps, result.dtype) == (fps, dtype)]
        games = tuple(summarise(result.game, [result.comparison]) for result in chosen)
        overall = summarise("all", [result.comparison for result in chosen])
        itself = tuple(
            summarise(
                f"pymunk, g x (1 + {part:.0e})".replace("e-0", "e-"), [result.sensitivity[part] for result in chosen]
            )
            for part in chosen[0].sensitivity
        )
        missed = tuple(missed_targets(fps, dtype, games, overall))
        tables.append(Section(fps, dtype, games, overall, itself, missed))
    return tables


def cells(row: Summary) -> tuple[str, ...]:
    """One row as text, in the order of `HEADINGS`."""
    return (
        row.name,
        str(row.plans),
        str(row.solved),
        f"{row.max_error:.1e}" if row.max_error else "0",
        *(percent(share) for share in (row.identical, *row.shares, row.same_flag, row.same_step)),
        percent(row.same_flag_solved),
        percent(row.same_step_solved),
        str(row.faults),
    )


def percent(share: float | None) -> str:
    """A share in %, to four digits."""
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
    for row in section.sensitivity:
        table.add_row(*cells(row), style="dim")
    return table


def targets_line(section: Section) -> str:
    """One line: every target is met, or which are missed."""
    if not section.missed:
        return f"{section.title}: every target is met"
    return f"{section.title}: MISSED: " + "; ".join(section.missed)


def headline(tables: Sequence[Section]) -> str:
    """The whole comparison in one line."""
    missed = sum(len(section.missed) for section in tables)
    facts = []
    for dtype in dict.fromkeys(section.dtype for section in tables):
        rows = [section.overall for section in tables if section.dtype == dtype]
        plays = sum(row.plans for row in rows)
        same, bits = (
            sum(getattr(row, name) * row.plans for row in rows) / plays for name in ("same_step", "identical")
        )
        exact = f", {percent(bits)} % equal bit for bit" if dtype == "float64" else ""
        facts.append(f"{dtype}: {plays} plays{exact}, {percent(same)} % with the same success step")
    targets_met = "Every target is met" if not missed else f"{missed} target{'s' * (missed > 1)} missed"
    return f"{targets_met}. {'; '.join(facts)}."


def inline(value: object) -> str:
    """A JSON value in one line of text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {inline(inner)}" for name, inner in value.items())
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
