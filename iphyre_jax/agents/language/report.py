"""The report of a run: rewards beside doing nothing, random plans and people, what was read, and why plays failed.

Bounds are computed when the report is made, with as many attempts, at the same rate, in the same space.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.agents.language.agent import DTYPE
from iphyre_jax.agents.language.replies import REASONS
from iphyre_jax.agents.language.settings import RunSettings
from iphyre_jax.analyses import oracle
from iphyre_jax.analyses.failures import SOURCES, failure_source
from iphyre_jax.analyses.figures import COLUMNS
from iphyre_jax.analyses.people import scores as scores_of_people
from iphyre_jax.attempts.agents import do_nothing, draw_randomly
from iphyre_jax.attempts.protocol import Agent, attempts
from iphyre_jax.intervals import mean_interval
from iphyre_jax.paper import paper_numbers
from iphyre_jax.provenance import provenance
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.train.reports.report import TITLES, markdown_table

RANDOM_RUNS: Final = 5
HANDWRITTEN: Final = (
    "**These replies were written by hand**, some right, some wrong, some unreadable, so that the whole command runs "
    "without a network. No model gave them. The figures check the machinery and are no model's score."
)

PLAYED: Final = "all played"
UNKNOWN: Final = "not known"  # why: the orders that solve a game are known of the forty alone
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """Rewards and successes of an agent, (G, R, k), by game."""

    reward: Floats
    success: npt.NDArray[np.bool_]


def scores_of_rows(settings: RunSettings, rows: Sequence[Mapping[str, Any]]) -> Scores:
    """Return the scores of a run's rows."""
    shape = (settings.samples, len(settings.games), settings.attempts)
    reward = np.array([row["reward"] for row in rows], np.float64).reshape(shape)
    success = np.array([row["success"] for row in rows], bool).reshape(shape)
    return Scores(reward.swapaxes(0, 1), success.swapaxes(0, 1))


def bounds(settings: RunSettings) -> dict[str, Scores]:
    """Play what knows nothing: doing nothing, and five runs of random plans with as many attempts."""
    agents: tuple[tuple[str, Agent, int], ...] = (
        ("do nothing", do_nothing, 1),
        (f"random plans, {RANDOM_RUNS} runs", draw_randomly, RANDOM_RUNS),
    )
    found = {}
    for name, agent, runs in agents:
        played = attempts(
            agent,
            settings.attempts,
            games=settings.games,
            runs=runs,
            fps=settings.fps,
            resets=settings.resets,
            dtype=DTYPE,
        )
        found[name] = Scores(played.reward, played.success)
    return found


def document(
    settings: RunSettings,
    rows: Sequence[Mapping[str, Any]],
    models: Sequence[str],
    calls: Sequence[Mapping[str, Any]],
    *,
    handwritten: bool,
) -> str:
    """Return the whole report.

    Args:
        settings: of the run.
        rows: as `runs.rows_of` returns them.
        models: kinds and names of what answered.
        calls: their parameters, see `settings.parameters`.
        handwritten: whether a person wrote replies.
    """
    mine = "hand-written replies" if handwritten else ", ".join(models)
    scores = {mine: scores_of_rows(settings, rows), **bounds(settings)}
    call = " and ".join(", ".join(f"{name} {value}" for name, value in one.items()) for one in calls)
    answered = "by hand" if handwritten else f"by {', '.join(models)} with {call}"
    origin = {"settings": {**settings.to_json(), "parameters": list(calls)}, **provenance()}
    parts = [
        "# Language models",
        "Written by `iphyre-jax ask`.",
        *([HANDWRITTEN] if handwritten else []),
        f"Answered {answered}. Prompt {settings.asked.name}, version and hash in the origin below. "
        f"{settings.fps} steps a second, reset {settings.resets}, {DTYPE}. {settings.samples} sample(s) of "
        f"{settings.attempts} attempt(s) at each game. In brackets: 95 % bootstrap interval over games. Doing nothing "
        "and random plans (official distribution, seed 0) were played now, with as many attempts."
        + ("" if settings.samples >= 5 else " Five samples a game are the least for a claim about a model."),
        f"## {settings.fps} steps a second",
        "### Reward, and games solved in %",
        split_table(settings, scores),
        "### What was read",
        reading_table(rows),
        "### Why attempts failed",
        "By the orders of removals in which a game can be solved (`iphyre-jax analyse failures` defines them).",
        failure_table(settings, rows),
        "### Game by game",
        game_table(settings, rows, scores),
        "## Origin of this document",
        f"```json\n{json.dumps(origin, indent=1)}\n```",
    ]
    return "\n\n".join(parts) + "\n"


def columns(settings: RunSettings) -> dict[str, tuple[str, ...]]:
    """Return the splits that were played whole, and all games played unless a split has them all."""
    played = set(settings.games)
    whole = {split: games for split, games in COLUMNS.items() if set(games) <= played}
    return whole if any(played == set(games) for games in whole.values()) else {**whole, PLAYED: settings.games}


def split_table(settings: RunSettings, scores: Mapping[str, Scores]) -> str:
    """Rewards and solved games by split: first attempt, and best of all attempts."""
    shown = columns(settings)
    index = {game: row for row, game in enumerate(settings.games)}
    best = f"best of {settings.attempts}"
    cells = []
    for name, score in scores.items():
        for what, last in (("first attempt", 1), (best, settings.attempts)):
            if last == 1 and what == best:
                continue  # one attempt: the first is the best
            reward = score.reward[:, :, :last].max(axis=2).mean(axis=1)
            solved = score.success[:, :, :last].any(axis=2).mean(axis=1)
            line = [[index[game] for game in games] for games in shown.values()]
            cells.append([f"{name}, {what}", *(_cell(reward[games], solved[games]) for games in line)])
    people = paper_numbers()["agents"]["Human"]
    if settings.fps == PEOPLE_FPS and set(shown) & set(people):
        told = [f"{people[split][0]:.1f}, {people[split][1]:.0f} %" if split in people else "-" for split in shown]
        cells.append(["people, best of 5 (paper)", *told])
    return markdown_table(["agent", *(TITLES.get(split, split) for split in shown)], cells)


def _cell(reward: Floats, solved: Floats) -> str:
    found, share = mean_interval(reward), mean_interval(solved)
    return f"{found.value:.1f} {found.bounds()}, {100 * share.value:.0f} % {share.bounds(scale=100)}"


def reading_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Replies and entries that could be used, removals, tokens and seconds."""
    questions = sum(row["questions"] for row in rows)
    unread = sum(row["unread"] for row in rows)
    cells = [
        ["attempts", str(len(rows))],
        ["replies", str(questions)],
        ["readable replies", f"{100 * (questions - unread) / questions:.1f} %"],
        ["replies cut off at the limit of tokens", str(sum(row["cut_off"] for row in rows))],
        ["attempts with a question that had no answer", str(sum(row["no_answer"] for row in rows))],
        *(
            [
                f"entries dropped for their {reason}" if reason != "repeated" else "entries dropped as repeated",
                str(total),
            ]
            for reason in REASONS
            if reason != "later"
            for total in [sum(row["dropped"][reason] for row in rows)]
        ),
        ["entries dropped as later than the next", str(sum(row["dropped"]["later"] for row in rows))],
        ["removals an attempt", f"{np.mean([row['eliminations'] for row in rows]):.2f}"],
        ["tokens of questions", str(sum(row["tokens_in"] for row in rows) or "not counted")],
        ["tokens of replies", str(sum(row["tokens_out"] for row in rows) or "not counted")],
        ["seconds of calls", f"{sum(row['call_seconds'] for row in rows):.1f}"],
    ]
    return markdown_table(["of all attempts", "figure"], cells)


def failure_table(settings: RunSettings, rows: Sequence[Mapping[str, Any]]) -> str:
    """Sources of failure by split: selection, order or timing of the blocks."""
    best = oracle.shipped(settings.fps)
    sources = SOURCES if set(settings.games) <= set(best) else (*SOURCES, UNKNOWN)
    cells = []
    for split, games in columns(settings).items():
        counts: Counter[str] = Counter()
        for row in rows:
            if row["game"] not in games:
                continue
            if row["game"] not in best:
                counts["solved" if row["success"] else UNKNOWN] += 1
            else:
                counts["solved" if row["success"] else failure_source(tuple(row["order"]), best[row["game"]])] += 1
        cells.append([TITLES.get(split, split), *(str(counts[source]) for source in sources)])
    return markdown_table(["attempts at", *sources], cells)


def game_table(settings: RunSettings, rows: Sequence[Mapping[str, Any]], scores: Mapping[str, Scores]) -> str:
    """One line a game: best of all attempts of each agent, and the score of people at their rate."""
    people = scores_of_people() if settings.fps == PEOPLE_FPS else {}
    cells = []
    for row, game in enumerate(settings.games):
        mine = [each for each in rows if each["game"] == game]
        questions, unread = (sum(each[name] for each in mine) for name in ("questions", "unread"))
        told = [f"{score.reward[row].max(axis=1).mean():.1f}" for score in scores.values()]
        solved = next(iter(scores.values())).success[row].any(axis=1).mean()
        cells.append(
            [game, f"{100 * solved:.0f} %", *told, *_person(people, game), f"{questions - unread}/{questions}"]
        )
    header = ["game", "solved", *scores, *(["people"] if people else []), "readable"]
    return f"Reward, best of {settings.attempts}.\n\n" + markdown_table(header, cells)


def _person(people: Mapping[str, float], game: str) -> list[str]:
    return [f"{people[game]:.1f}" if game in people else "-"] if people else []
