"""Slack: how long each removal of a plan may wait, or how much sooner it may come, and the game is still solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.figures import spearman
from iphyre_jax.analyses.search import play_plans_of
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.kept_rows import Row
from iphyre_jax.rules import NEVER, TIME_LIMIT
from iphyre_jax.scenes import GAMES, Scene
from iphyre_jax.train.reports.report import markdown_table

FIRST_LOOK: Final = 8  # steps to each side; the next look is twice as wide
BOUNDS: Final = (0.5, 2.0)  # s, round ones; games of equal slack are never parted


def slack_of(scene: Scene, plan: npt.NDArray[np.int64], fps: int, resets: int) -> list[float | None]:
    """Return the width of the interval in which each removal of a plan may fall, s; None for a block that stays.

    The interval is that of steps around the plan's own, all others fixed, in which the game is solved without a gap,
    counted in steps: one step alone has a width of 1 / fps. All plays are float64.

    Args:
        scene: the game.
        plan: (S,) steps of a plan that solves it.
        fps: physics steps a second.
        resets: number of the reset.
    """
    last = round(TIME_LIMIT * fps) - 1
    sides = {(slot, way): 0 for slot in np.flatnonzero(plan != NEVER).tolist() for way in (-1, 1)}
    done: set[tuple[int, int]] = set()
    look = FIRST_LOOK
    while len(done) < len(sides):
        rows = [
            (side, to)
            for side in sides
            if side not in done
            for to in range(sides[side] + 1, sides[side] + look + 1)
            if 1 <= plan[side[0]] + side[1] * to <= last
        ]
        solved = _solved(scene, plan, rows, fps, resets)
        for side in set(sides) - done:
            reached = sides[side]
            while solved.get((side, reached + 1), False):
                reached += 1
            if reached < sides[side] + look:
                done.add(side)
            sides[side] = reached
        look *= 2
    return [
        None if step == NEVER else (sides[slot, -1] + sides[slot, 1] + 1) / fps
        for slot, step in enumerate(plan.tolist())
    ]


def _solved(
    scene: Scene, plan: npt.NDArray[np.int64], rows: list[tuple[tuple[int, int], int]], fps: int, resets: int
) -> dict[tuple[tuple[int, int], int], bool]:
    """Whether the game is solved with one removal moved by so many steps to one side."""
    if not rows:
        return {}
    plans = np.repeat(plan[None], len(rows), axis=0)
    for row, ((slot, way), by) in enumerate(rows):
        plans[row, slot] += way * by
    success = play_plans_of(scene, plans, fps, resets, "float64")[1]
    return dict(zip(rows, success.tolist(), strict=True))


def document(oracles: Mapping[int, Mapping[str, Row]], policies: Sequence[Policy]) -> str:
    """Return the document: the smallest slack of each game's best plan, and agents' successes by it."""
    parts = [
        "# Slack",
        "Written by `iphyre-jax analyse slack`. Smallest width, over the removals of the plan with the highest reward, "
        "of the interval in which that removal may fall: how exact the timing of that plan is. Plans that solve a game "
        "with one removal more, or later, may leave far more room. Policies: shipped ones (each the best of five "
        "seeds), share of 20 sampled episodes solved, mean over the games of each range of slack; Spearman's rank "
        "correlation of the two over all of these games.",
    ]
    for fps, rows in oracles.items():
        least = {game: width for game, row in rows.items() if (width := least_slack(row)) is not None}
        if not set(GAMES) <= set(rows):
            continue
        ordered = sorted(least, key=lambda game: least[game])
        parts += [
            f"## {fps} steps a second",
            markdown_table(["game", "smallest slack, s"], [[game, f"{least[game]:.3f}"] for game in ordered]),
        ]
        if others := [game for game in GAMES if game not in least]:
            parts.append(f"No plan known, or the best one removes nothing: {', '.join(others)}.")
        parted = ranges(least)
        cells = []
        for policy in policies:
            if policy.fps != fps:
                continue
            solved = policy.values("sampled", "success")
            found = spearman([least[game] for game in ordered], [solved[game] for game in ordered])
            shares = [f"{100 * float(np.mean([solved[game] for game in part])):.0f}" for part in parted.values()]
            cells.append([policy.name, *shares, f"{found:.2f}"])
        if cells:
            parts.append(markdown_table(["policy: solved % by slack", *parted, "Spearman"], cells))
    return "\n\n".join(parts) + "\n"


def ranges(least: Mapping[str, float]) -> dict[str, list[str]]:
    """Return the games of each range of slack between BOUNDS, by its title; ranges without games are left out."""
    edges = (-np.inf, *BOUNDS, np.inf)
    names = (f"below {BOUNDS[0]:g} s", f"{BOUNDS[0]:g} to {BOUNDS[1]:g} s", f"{BOUNDS[1]:g} s or more")
    found = {}
    for name, low, high in zip(names, edges[:-1], edges[1:], strict=True):
        if games := [game for game, width in least.items() if low <= width < high]:
            found[f"{name} ({len(games)} of {len(least)})"] = games
    return found


def least_slack(row: Row) -> float | None:
    """Return the smallest slack of a row's best plan, s; None if none solves the game, or it solves itself."""
    widths = [float(width) for width in row["slack"] or [] if width is not None]
    return min(widths, default=None)
