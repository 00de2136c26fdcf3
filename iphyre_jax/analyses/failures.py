"""Why agents fail: wrong blocks, wrong order or wrong timing, by four definitions.

The paper asks whether the oracle's order occurs in the agent's, and does not say how. "equal" and "subsequence" are the
two readings. Both depend on the one oracle plan that happens to be best. "feasible" does not: it asks whether some
timing of the agent's own order is known to solve the game. These leave out games that no known plan solves at the
policy's rate; and orders without a removal, which occur in every plan, are no right orders. The paper divides by all
failures, and its oracle played at 60 steps a second: that is the fourth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final, Literal

from iphyre_jax.analyses.figures import COLUMNS, share
from iphyre_jax.analyses.oracle import orders_of
from iphyre_jax.analyses.orders import BlockOrder
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.kept_rows import Row
from iphyre_jax.paper import paper_numbers
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.train.reports.report import TITLES, markdown_table

Source = Literal["solved", "impossible", "selection", "order", "timing"]
SOURCES: Final[tuple[Source, ...]] = ("solved", "impossible", "selection", "order", "timing")


def is_subsequence(order: Sequence[int], longer: Sequence[int]) -> bool:
    """Whether the entries of an order occur in a longer one, in the same relative order."""
    rest = iter(longer)
    return all(slot in rest for slot in order)


def failure_source(order: BlockOrder, row: Row) -> Source:
    """Return why a play with this executed order failed, by the orders in which the game can be solved.

    "impossible": no plan that solves the game is known; "timing": another timing of this order solves it; "order":
    another order of the same blocks does; "selection": no order of these blocks is known to.
    """
    feasible = orders_of(row)
    if not feasible:
        return "impossible"
    if order in feasible:
        return "timing"
    return "order" if any(set(order) == set(other) and len(order) == len(other) for other in feasible) else "selection"


def order_of_greedy(policy: Policy, game: str) -> BlockOrder:
    """Return the order that a policy's greedy plan executed."""
    steps = round(min(policy.games[game]["greedy"]["seconds"], TIME_LIMIT) * policy.fps)
    plan = policy.greedy_plan(game)
    gone = [slot for slot, step in enumerate(plan) if 0 <= step < steps]
    return tuple(sorted(gone, key=lambda slot: plan[slot]))


def timing_share(policy: Policy, games: Sequence[str], oracle: Mapping[str, Row], *, equal: bool) -> tuple[int, int]:
    """Return the failures with the oracle's order, equal or as a subsequence, and all failures where it has one."""
    failed = [game for game in _failed(policy, games) if oracle[game]["solved"] and oracle[game]["order"]]
    right = 0
    for game in failed:
        best, played = tuple(oracle[game]["order"]), order_of_greedy(policy, game)
        right += best == played if equal else is_subsequence(best, played)
    return right, len(failed)


def paper_share(policy: Policy, games: Sequence[str], oracle_60: Mapping[str, Row]) -> tuple[int, int]:
    """Return the failures in whose order that of the oracle at 60 steps a second occurs, and all failures."""
    return timing_share(policy, games, oracle_60, equal=False)[0], len(_failed(policy, games))


def _failed(policy: Policy, games: Sequence[str]) -> list[str]:
    """The games that a policy's greedy plan does not solve."""
    return [game for game in games if not policy.games[game]["greedy"]["success"]]


def sources(policy: Policy, games: Sequence[str], oracle: Mapping[str, Row]) -> Counter[Source]:
    """Return how often each source occurs among a policy's greedy plays of games."""
    found: Counter[Source] = Counter()
    for game in games:
        solved = bool(policy.games[game]["greedy"]["success"])
        found["solved" if solved else failure_source(order_of_greedy(policy, game), oracle[game])] += 1
    return found


def document(policies: Sequence[Policy], oracles: Mapping[int, Mapping[str, Row]]) -> str:
    """Return the document of all policies that act in advance; each is judged by the oracle of its own rate."""
    parts = [
        "# Sources of failure",
        "Written by `iphyre-jax analyse failures`. Greedy plans of the shipped policies (each the best of five "
        "seeds). Timing: this order of removals is feasible, so another timing of it solves the game. Order: "
        "another order of the same blocks is feasible. Selection: no order of these blocks is known to be "
        "feasible. Impossible: no plan is known to solve the game. Feasible orders are those of `iphyre-jax "
        "analyse oracle`; an order that the search missed would move a failure from order or selection to timing.",
    ]
    for fps, oracle in oracles.items():
        chosen = [policy for policy in policies if policy.plans_ahead and policy.fps == fps]
        if not chosen or not set(COLUMNS["all"]) <= set(oracle):
            continue
        parts.append(f"## {fps} steps a second")
        for split, games in COLUMNS.items():
            cells = []
            for policy in chosen:
                counts = sources(policy, games, oracle)
                cells.append([policy.name, *(str(counts[source]) for source in SOURCES)])
            parts += [f"### {TITLES[split]}: games", markdown_table(["policy", *SOURCES], cells)]
        parts += ["### Failures by timing alone, four definitions", _definitions(chosen, oracle, oracles.get(60, {}))]
    shares = ", ".join(f"{value:.2f}" for value in paper_numbers()["failures_by_timing"])
    parts.append(
        "As the paper divides: failures in whose order that of the oracle at 60 steps a second occurs, of all. "
        f"The paper states {shares} % for PPO, A2C and SAC, and does not define the right order. The other columns "
        "leave out games without a known plan; the second and the third also those whose best plan removes nothing."
    )
    return "\n\n".join(parts) + "\n"


def _definitions(policies: Sequence[Policy], oracle: Mapping[str, Row], oracle_60: Mapping[str, Row]) -> str:
    """Share of failures by timing, with Wilson intervals, by four definitions; the paper's if its oracle is there."""
    cells = []
    as_paper = set(COLUMNS["all"]) <= set(oracle_60)
    for policy in policies:
        counts = sources(policy, COLUMNS["all"], oracle)
        possible = counts["selection"] + counts["order"] + counts["timing"]
        pairs = [
            (counts["timing"], possible),
            timing_share(policy, COLUMNS["all"], oracle, equal=False),
            timing_share(policy, COLUMNS["all"], oracle, equal=True),
            paper_share(policy, COLUMNS["all"], oracle_60) if as_paper else (0, 0),
        ]
        cells.append([policy.name, *(_percent(hits, trials) for hits, trials in pairs)])
    heads = ["feasible order", "oracle's order as a subsequence", "oracle's order, equal", "as the paper divides"]
    return markdown_table(["policy", *heads], cells)


def _percent(hits: int, trials: int) -> str:
    found = share(hits, trials)
    return (
        f"{hits} of {trials}: {100 * found.value:.1f} % [{100 * found.low:.0f}, {100 * found.high:.0f}]"
        if trials
        else "-"
    )
