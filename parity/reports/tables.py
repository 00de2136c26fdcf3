"""The tables of a comparison: one for each frame rate and type, one row a game."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table

from parity.engines import reference
from parity.play import GameResult
from parity.reports.summary import Summary, summarise
from parity.reports.verdict import missed_targets
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
    "max px: largest error in play; bits: % of plans whose poses are all equal bit for bit; 1e-9 to 1 px: % of plans "
    "within it; flag, step: % of plans with the same success flag and step, * of those that the reference solves"
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
        missed: the targets that are missed, one sentence each.
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
    """Sort the results of all games into one section for each frame rate and type, in order of appearance."""
    made = []
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
        made.append(Section(fps, dtype, games, overall, itself, missed))
    return made


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


def verdict_line(section: Section) -> str:
    """One line: the targets are reached, or which are not."""
    if not section.missed:
        return f"{section.title}: every target is reached"
    return f"{section.title}: MISSED: " + "; ".join(section.missed)


def headline(made: Sequence[Section]) -> str:
    """The verdict on the whole comparison in one line."""
    missed = sum(len(section.missed) for section in made)
    facts = []
    for dtype in dict.fromkeys(section.dtype for section in made):
        rows = [section.overall for section in made if section.dtype == dtype]
        plays = sum(row.plans for row in rows)
        same, bits = (
            sum(getattr(row, name) * row.plans for row in rows) / plays for name in ("same_step", "identical")
        )
        exact = f"{percent(bits)} % of {plays} plays equal bit for bit, " if dtype == "float64" else ""
        facts.append(f"{dtype}: {exact}success step equal in {percent(same)} %")
    verdict = "Every target is reached" if not missed else f"{missed} target{'s' * (missed > 1)} missed"
    return f"{verdict}. {'; '.join(facts)}."
