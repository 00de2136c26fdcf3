"""`iphyre-jax analyse`: rows that are missing, then the documents. Needs the extra `train`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, Literal

import tyro
from rich.console import Console

from iphyre_jax.agents.language import runs, transcripts
from iphyre_jax.agents.language.answers import Replay
from iphyre_jax.analyses import (
    attempts_rows,
    claims,
    difficulty,
    failures,
    oracle,
    people,
    protocols,
    seeds,
    slack,
    tables,
)
from iphyre_jax.analyses.imagination import report as imagination
from iphyre_jax.analyses.shipped import policies
from iphyre_jax.cli.ask import Ask
from iphyre_jax.cli.console import option
from iphyre_jax.files import file_sum, replace_text
from iphyre_jax.kept_rows import Row, rows_there
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.reports.printing import say

What = Literal[
    "oracle",
    "difficulty",
    "slack",
    "failures",
    "people",
    "within-template",
    "games",
    "protocols",
    "attempts",
    "imagination",
    "claims",
]
SEEDS: Final = 5  # of the difficulty
# Where the rows of documents are that would lack something without them; the imagination needs all of its own.
ROWS_OF: Final[Mapping[What, str]] = MappingProxyType(
    {
        "oracle": "oracle-*/*.json",
        "difficulty": "difficulty-*/*.json",
        "attempts": "attempts-*/*.json",
        "protocols": "protocols/*.json",
        "claims": "difficulty-60fps-0/*.json",
    }
)
OF_SEEDS: Final[frozenset[What]] = frozenset({"within-template", "claims"})


@dataclass(frozen=True)
class Analyse:
    """Analyse games, agents and people: compute the rows that are missing and write the documents.

    Rows are kept, so that an interrupted command goes on where it stopped.
    """

    what: Annotated[
        tyro.conf.Positional[tuple[What, ...]],
        option(
            "ANALYSIS ...",
            "oracle, difficulty, slack, failures, people, within-template, games, protocols, "
            "attempts, imagination, claims, in the order in which they are made.",
            "all of them",
        ),
    ] = ()
    rows: Path = Path("build/analyses")
    """Folder of the rows."""
    out: Path = Path("docs/results")
    """Folder of the documents."""
    runs: Path = Path("docs/results/runs")
    """Folder of the seeds that `make results` published; within-template and claims read it."""
    data: Path | None = None
    """Folder to write what the oracle found into, once it is whole: the data that the package ships."""
    written_only: bool = False
    """Compute nothing: write the documents of the rows that are there."""


def run(command: Analyse, console: Console) -> None:
    """Run the command.

    Raises:
        ValueError, OSError: one line.
    """
    chosen = command.what or tuple(DOCUMENTS)
    if not command.written_only and not OF_SEEDS.isdisjoint(chosen):
        seeds.published(command.runs)  # before anything is computed
    for what in chosen:
        if command.written_only and not _has_rows(command, what):
            say(console, f"{what}: no rows in {command.rows}; its document stays as it is")
            continue
        text = DOCUMENTS[what](command, console)
        text += f"\n## Origin of this document\n\n```json\n{json.dumps(provenance(), indent=1)}\n```\n"
        command.out.mkdir(parents=True, exist_ok=True)
        file = command.out / f"{what}.md"
        replace_text(file, text)
        say(console, f"{file}")


def _has_rows(command: Analyse, what: What) -> bool:
    """Whether a document can be written of the rows and seeds that are there, or needs none."""
    if what == "imagination":
        return imagination.is_whole(command.rows)
    has_seeds = what not in OF_SEEDS or any(command.runs.glob("*/seed-*"))
    return has_seeds and (what not in ROWS_OF or any(command.rows.glob(ROWS_OF[what])))


def _oracle(command: Analyse, console: Console) -> str:
    """Search game by game."""
    tables_of: dict[int, dict[str, Row]] = {}
    if command.data is not None:
        command.data.mkdir(parents=True, exist_ok=True)
    for fps in oracle.RATES:
        if not command.written_only:
            for game in GAMES:
                with console.status(f"oracle at {fps}: {game}"):
                    oracle.run(command.rows, fps, [game])
        wanted = dict.fromkeys(GAMES, oracle.settings(fps))
        tables_of[fps] = rows_there(command.rows / f"oracle-{fps}fps", wanted)
        if command.data is not None and len(tables_of[fps]) == len(GAMES):
            oracle.export(tables_of[fps], fps, command.data / oracle.file_of(fps).name)
    return oracle.document(tables_of)


def _difficulty(command: Analyse, console: Console) -> str:
    """Measure seed by seed, game by game."""
    rates: dict[int, list[dict[str, Row]]] = {fps: [] for fps in oracle.RATES}
    for seed in range(SEEDS):
        for fps in oracle.RATES:
            for game in () if command.written_only else GAMES:
                with console.status(f"difficulty at {fps}, seed {seed}: {game}"):
                    difficulty.run(command.rows, fps, seed, [game])
            rates[fps].append(difficulty.rows_there_of(command.rows, fps, seed))
    return difficulty.document(rates)


def _attempts(command: Analyse, console: Console) -> str:
    """Let every agent try."""
    found: dict[int, dict[str, Row]] = {}
    missing: dict[int, list[str]] = {}
    for fps in oracle.RATES:
        names = {**attempts_rows.specifications(fps), **_replies(fps)}
        for name, specification in () if command.written_only else names.items():
            with console.status(f"attempts at {fps}: {name}"):
                attempts_rows.run(command.rows, fps, name, specification)
        stems = {attempts_rows.file_stem(name): name for name in names}
        wanted = {stem: names[name][0] for stem, name in stems.items()}
        kept = rows_there(command.rows / f"attempts-{fps}fps", wanted)
        found[fps] = {stems[stem]: row for stem, row in kept.items()}
        missing[fps] = [name for name in names if name not in found[fps]]
    return attempts_rows.document(found, missing)


def _replies(fps: int) -> dict[str, attempts_rows.Specification]:
    """The language-model agent with the hand-written replies of the package, at the rate that they were written for."""
    settings, file = Ask().settings(), transcripts.handwritten_file()
    if fps != settings.fps:
        return {}
    decides = {**settings.to_json(), "replies": file_sum(file)}
    return {"hand-written replies": (decides, lambda: runs.run(settings, Replay(file, settings)).played[0])}


def _imagination(command: Analyse, console: Console) -> str:
    """Imagine game by game."""
    for game in () if command.written_only else GAMES:
        with console.status(f"imagination: {game}"):
            imagination.compute(command.rows, game)
    return imagination.document(command.rows)


def _claims(command: Analyse, console: Console) -> str:
    """Judge the claims by what the other analyses found."""
    del console
    counts = difficulty.rows_there_of(command.rows, 60, 0)
    whole = counts if set(GAMES) <= set(counts) else None
    return claims.document(claims.claims(policies(), seeds.published(command.runs), oracle.shipped(10), whole))


def _protocols(command: Analyse, console: Console) -> str:
    """Play the policies that are missing."""
    if command.written_only:
        wanted = {name: protocols.settings(name) for name in protocols.POLICIES}
        return protocols.document(rows_there(command.rows / "protocols", wanted))
    with console.status("protocols"):
        return protocols.document(protocols.run(command.rows))


def _shipped() -> dict[int, dict[str, Row]]:
    return {fps: dict(oracle.shipped(fps)) for fps in oracle.RATES}


DOCUMENTS: Final[dict[What, Callable[[Analyse, Console], str]]] = {
    "oracle": _oracle,
    "difficulty": _difficulty,
    "slack": lambda command, console: slack.document(_shipped(), policies(), people.success_rates()),
    "failures": lambda command, console: failures.document(policies(), _shipped()),
    "people": lambda command, console: people.document(),
    "within-template": lambda command, console: tables.within_template_document(seeds.published(command.runs)),
    "games": lambda command, console: tables.games_document(policies()),
    "protocols": _protocols,
    "attempts": _attempts,
    "imagination": _imagination,
    "claims": _claims,
}
