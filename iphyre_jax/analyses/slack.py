"""Slack: how long each removal of a plan may wait, or how much sooner it may come, and the game is still solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.figures import spearman
from iphyre_jax.analyses.search import CHUNK, Plans, neighbours, play_plans_of, with_distinct_steps
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.kept_rows import Row
from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER, PEOPLE_FPS, TIME_LIMIT
from iphyre_jax.scenes import GAMES, Scene
from iphyre_jax.train.reports.report import markdown_table

FIRST_LOOK: Final = 8  # places to each side; the next look is twice as wide
STARTS: Final = 64  # plans that a search starts from, at most
WIDEST: Final = 4  # plans with most slack that are kept from round to round
NEAR: Final = 1024  # plans near them that are played in a round
MEASURED: Final = 32  # of those that solve the game, plans whose slack is measured
SPREADS: Final = (4.0, 2.0, 1.0, 0.5)  # s, standard deviation of a move in each round
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
    return _seconds(plan, _Search(scene, fps, resets).sides(plan[None])[0], fps)


def _seconds(plan: npt.NDArray[np.int64], sides: npt.NDArray[np.int64], fps: int) -> list[float | None]:
    """Return the widths of a plan's intervals, s, of how many steps sooner and later each removal may come, (S, 2)."""
    widths = ((sides.sum(axis=1) + 1) / fps).tolist()
    return [None if step == NEVER else width for step, width in zip(plan.tolist(), widths, strict=True)]


def widest_plan(
    scene: Scene, plans: Plans, fps: int, resets: int, seed: int
) -> tuple[npt.NDArray[np.int64], list[float | None]]:
    """Return the plan (S,) with the largest smallest slack found, from plans that solve the game, and its `slack_of`.

    First plans near those with most slack are measured, in tenths of a second; then removals move to the middle of
    their intervals, as long as that finds more. Of equal plans the first counts. All plays are float64.

    Args:
        scene: the game.
        plans: (N, S) steps, those with fewest removals first; STARTS of them count.
        fps: physics steps a second.
        resets: number of the reset.
        seed: of the random numbers.
    """
    rng, exact = np.random.default_rng([seed, 2]), _Search(scene, fps, resets)
    coarse = replace(exact, stride=max(fps // DECISIONS_PER_SECOND, 1))
    kept, sides = _widest(plans[:STARTS], coarse.sides(plans[:STARTS]))
    for spread in SPREADS:
        near = exact.solved(np.unique(neighbours(rng, kept, NEAR, spread * fps, exact.last + 1), axis=0))
        near = np.concatenate([rng.permutation(near)[:MEASURED], exact.solved(_to_middle(kept, sides * coarse.stride))])
        kept, sides = _widest(np.concatenate([kept, near]), np.concatenate([sides, coarse.sides(near)]))
    sides, least = exact.sides(kept), -1
    while (found := int(_least(kept, sides).max())) > least:
        least = found
        moved = exact.solved(_to_middle(kept, sides))
        kept, sides = _widest(np.concatenate([kept, moved]), np.concatenate([sides, exact.sides(moved)]))
    return kept[0], _seconds(kept[0], sides[0], fps)


@dataclass(frozen=True)
class _Search:
    """How a search plays the plans of a game, (N, S) steps."""

    scene: Scene
    fps: int
    resets: int
    stride: int = 1  # steps between the places where a removal is tried

    @property
    def last(self) -> int:
        """The last step of an episode."""
        return round(TIME_LIMIT * self.fps) - 1

    def solve(self, plans: Plans) -> npt.NDArray[np.bool_]:
        """Return whether each plan solves the game, (N,)."""
        parts = [plans[first : first + CHUNK] for first in range(0, len(plans), CHUNK)]
        played = [play_plans_of(self.scene, part, self.fps, self.resets, "float64")[1] for part in parts]
        return np.concatenate([np.zeros(0, bool), *played])

    def solved(self, plans: Plans) -> Plans:
        """Return the plans that solve the game."""
        return plans[self.solve(plans)]

    def sides(self, plans: Plans) -> Plans:
        """Return how many strides sooner and later each removal may come, (N, S, 2)."""
        sides = np.zeros((*plans.shape, 2), np.int64)
        going_on = np.stack([plans != NEVER] * 2, axis=-1)
        look = FIRST_LOOK
        while going_on.any():
            row, slot, side = np.nonzero(going_on)
            by = (sides[row, slot, side][:, None] + np.arange(1, look + 1)) * self.stride
            to = plans[row, slot][:, None] + np.where(side == 0, -1, 1)[:, None] * by
            solved = (to >= 1) & (to <= self.last)
            which = np.nonzero(solved)[0]
            moved = plans[row[which]]
            moved[np.arange(len(which)), slot[which]] = to[solved]
            solved[solved] = self.solve(moved)
            reached = np.logical_and.accumulate(solved, axis=1).sum(axis=1)
            sides[row, slot, side] += reached
            going_on[row, slot, side] = reached == look
            look *= 2
        return sides


def _to_middle(plans: Plans, sides: Plans) -> Plans:
    """Return the plans with one removal in the middle of its interval, or with all; sides: in steps."""
    by = np.trunc((sides[..., 1] - sides[..., 0]) / 2).astype(np.int64)
    alone = [plans + by * slot for slot in np.eye(plans.shape[1], dtype=np.int64)]
    moved = np.unique(np.concatenate([plans + by, *alone]), axis=0)
    return with_distinct_steps(moved[~(moved[:, None] == plans).all(axis=2).any(axis=1)])


def _least(plans: Plans, sides: Plans) -> npt.NDArray[np.int64]:
    """Return the smallest sum of the two sides of each plan's removals, (N,)."""
    return np.where(plans == NEVER, np.iinfo(np.int64).max, sides.sum(axis=2)).min(axis=1)


def _widest(plans: Plans, sides: Plans) -> tuple[Plans, Plans]:
    """Return the WIDEST plans with most slack and their sides, the first with the most."""
    best = np.argsort(-_least(plans, sides), kind="stable")[:WIDEST]
    return plans[best], sides[best]


def document(oracles: Mapping[int, Mapping[str, Row]], policies: Sequence[Policy], people: Mapping[str, float]) -> str:
    """Return the document: the smallest slack of two plans of each game, and who solves games by it.

    Args:
        oracles: rows of the oracle by rate and game.
        policies: shipped ones.
        people: share of people who solve each game, at PEOPLE_FPS.
    """
    parts = [
        "# Slack",
        "Written by `iphyre-jax analyse slack`. How exact must the timing be? Slack: smallest width, over the removals "
        "of a plan, of the interval in which that removal may fall, all others fixed. Of two plans: the one with the "
        "highest reward, and the widest one found, whose slack is the largest; there may be wider ones. Policies: "
        "shipped ones (each the best of five seeds), share of 20 sampled episodes solved, mean over the games of each "
        "range of slack. People: share who solve a game within five attempts, derived as in [People](people.md). "
        "Spearman's rank correlation of slack and share over all of these games.",
    ]
    for fps, rows in oracles.items():
        if not set(GAMES) <= set(rows):
            continue
        shares: dict[str, Mapping[str, float]] = {"people, derived": people} if fps == PEOPLE_FPS else {}
        shares |= {policy.name: policy.values("sampled", "success") for policy in policies if policy.fps == fps}
        parts += [f"## {fps} steps a second", _games_table(rows)]
        for title, number in (("No plan known", None), ("Solved without a removal", 0)):
            if games := [game for game in GAMES if _fewest_removals(rows[game]) == number]:
                parts.append(f"{title}: {', '.join(games)}.")
        parts += [_solvers_table(least, title, shares) for title, least in _least_of(rows).items()]
    return "\n\n".join(parts) + "\n"


def _fewest_removals(row: Row) -> int | None:
    """Return the fewest removals of a plan that solves a game; None if no plan is known."""
    return min((len(found["order"]) for found in row["orders"]), default=None)


def _least_of(rows: Mapping[str, Row]) -> dict[str, dict[str, float]]:
    """Return the smallest slack by game of the best and of the widest plans."""
    return {
        title: {game: width for game, row in rows.items() if (width := least_slack(row[key])) is not None}
        for title, key in (("best", "slack"), ("widest", "widest_slack"))
    }


def _games_table(rows: Mapping[str, Row]) -> str:
    """One line a game, by the slack of its widest plan; those without a removal last."""
    best, widest = _least_of(rows).values()
    cells = []
    for game in sorted({**widest, **best}, key=lambda game: widest.get(game, np.inf)):
        removals = [str(sum(step != NEVER for step in rows[game][key])) for key in ("plan", "widest_plan")]
        slack = [f"{least[game]:.3f}" if game in least else "-" for least in (best, widest)]
        cells.append([game, slack[0], removals[0], slack[1], removals[1]])
    header = ["game", "slack of the best plan, s", "its removals", "of the widest plan, s", "its removals"]
    return markdown_table(header, cells)


def _solvers_table(least: Mapping[str, float], title: str, shares: Mapping[str, Mapping[str, float]]) -> str:
    """Share solved by range of slack, of each policy and of people."""
    parted, games, cells = ranges(least), list(least), []
    for name, solved in shares.items():
        found = spearman([least[game] for game in games], [solved[game] for game in games])
        means = [f"{100 * float(np.mean([solved[game] for game in part])):.0f}" for part in parted.values()]
        cells.append([name, *means, f"{found:.2f}"])
    return markdown_table([f"solved %, by slack of the {title} plan", *parted, "Spearman"], cells)


def ranges(least: Mapping[str, float]) -> dict[str, list[str]]:
    """Return the games of each range of slack between BOUNDS, by its title; ranges without games are left out."""
    edges = (-np.inf, *BOUNDS, np.inf)
    names = (f"below {BOUNDS[0]:g} s", f"{BOUNDS[0]:g} to {BOUNDS[1]:g} s", f"{BOUNDS[1]:g} s or more")
    found = {}
    for name, low, high in zip(names, edges[:-1], edges[1:], strict=True):
        if games := [game for game, width in least.items() if low <= width < high]:
            found[f"{name} ({len(games)} of {len(least)})"] = games
    return found


def least_slack(widths: Sequence[float | None] | None) -> float | None:
    """Return the smallest of a plan's slacks, s; None if there is no plan, or it removes nothing."""
    return min((width for width in widths or () if width is not None), default=None)
