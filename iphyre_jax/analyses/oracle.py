"""The oracle: best plans of the forty games by search, with their slack and the orders that can solve a game.

The package ships what a whole search found, `oracle-10fps.json` and `oracle-60fps.json`: data of one version, which
`iphyre-jax analyse oracle` finds again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.analyses.figures import COLUMNS, by_split
from iphyre_jax.analyses.orders import BlockOrder, executed_order, feasible_orders, possible_orders
from iphyre_jax.analyses.search import CLIMBED, PAIR_STEPS, decide, search_plans
from iphyre_jax.analyses.slack import MEASURED, SPREADS, slack_of, widest_plan
from iphyre_jax.files import read_versioned, replace_text
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.paper import paper_numbers
from iphyre_jax.rules import DECISIONS_PER_SECOND
from iphyre_jax.scenes import GAMES, load_scene
from iphyre_jax.train.reports.report import TITLES, markdown_table

SCHEMA: Final = "iphyre_jax/oracle"
VERSION: Final = 2  # 1 had no widest plans
RATES: Final = (60, 10)
RESETS: Final[Mapping[int, int]] = {60: 1, 10: 2}  # as people and data sets play; as the official environments
MOST_PLANS: Final[Mapping[int, int]] = {60: 8192, 10: 32_768}  # random plans of a game
MOST_ORDER_PLAYS: Final[Mapping[int, int]] = {60: 4096, 10: 8192}  # further plays for orders


def settings(fps: int) -> dict[str, Any]:
    """Return what decides a row."""
    return {
        "fps": fps,
        "resets": RESETS[fps],
        "dtype": "float32 for the search, float64 for enumerations and for what was found",
        "random plans": MOST_PLANS[fps],
        "plays for orders": MOST_ORDER_PLAYS[fps],
        "climb": f"{CLIMBED} plans, pairs by {PAIR_STEPS} steps",
        "widest": f"{len(SPREADS)} rounds, {MEASURED} plans each",
        "seed": 0,
    }


def find(game: str, fps: int) -> Row:
    """Search one game and return its row as JSON values."""
    scene, resets = load_scene(game), RESETS[fps]
    tried = search_plans(scene, fps, resets, known_plans(game, fps), MOST_PLANS[fps], 0)
    plan, reward, success, steps = decide(tried)
    proofs = feasible_orders(tried, MOST_ORDER_PLAYS[fps], 0)
    widest = widest_plan(scene, np.array(list(proofs.values())), fps, resets, 0) if proofs else None
    return {
        "game": game,
        "solved": success,
        "reward": reward,
        "seconds": steps / fps,
        "plan": plan.tolist(),
        "order": list(executed_order(plan, steps)),
        "slack": slack_of(scene, plan, fps, resets) if success else None,
        "widest_plan": None if widest is None else widest[0].tolist(),
        "widest_slack": None if widest is None else widest[1],
        "plays": len(tried.plans),
        "enumerated": tried.enumerated,
        "orders": [{"order": list(order), "plan": proof.tolist()} for order, proof in proofs.items()],
    }


def known_plans(game: str, fps: int) -> list[list[int]]:
    """Return plans from which a search also starts: the best one and the proofs that ship, which a search found too."""
    row = shipped(fps)[game]
    return [row["plan"], *(found["plan"] for found in row["orders"])]


def run(folder: Path, fps: int, games: Sequence[str] = GAMES) -> dict[str, Row]:
    """Return the rows of games, searching those that are missing in `folder`/oracle-<fps>fps."""
    kept = folder / f"oracle-{fps}fps"
    return {game: kept_row(kept, game, settings(fps), partial(find, game, fps)) for game in games}


def file_of(fps: int) -> Path:
    """Return the package's file of a rate."""
    return Path(str(files(__package__).joinpath(f"oracle-{fps}fps.json")))


def export(rows: Mapping[str, Row], fps: int, file: Path) -> None:
    """Write rows as the package's data, one game a line."""
    head = {"schema": SCHEMA, "version": VERSION, "settings": settings(fps)}
    games = ",\n  ".join(json.dumps(dict(rows[game])) for game in rows)
    replace_text(file, f'{json.dumps(head)[:-1]},\n "games": [\n  {games}\n ]}}\n')


@cache
def shipped(fps: int) -> Mapping[str, Row]:
    """Return the package's rows of a rate by game.

    Raises:
        ValueError, OSError: one line; the file is damaged or missing.
    """
    file = file_of(fps)
    return {row["game"]: row for row in read_versioned(file, SCHEMA, (VERSION,))["games"]}


def best_known(fps: int) -> dict[str, tuple[float, float]]:
    """Return mean reward and share solved of the best plans known at a rate, by split; "all" for the forty.

    Raises:
        ValueError, OSError: as `shipped`.
    """
    rows = shipped(fps)
    reward, solved = (by_split({game: float(rows[game][key]) for game in GAMES}) for key in ("reward", "solved"))
    return {split: (reward[split], solved[split]) for split in COLUMNS}


def orders_of(row: Row) -> set[BlockOrder]:
    """Return the feasible orders of a row."""
    return {tuple(found["order"]) for found in row["orders"]}


def document(tables: Mapping[int, Mapping[str, Row]]) -> str:
    """Return the document of the rows of each rate; it says what is missing."""
    parts = [
        "# Oracle",
        "Written by `iphyre-jax analyse oracle`. Best plans by search: no plan is entered by hand. Reward: 1000 - 10 "
        "for each removal - seconds. Slack: width of the interval of steps in which that removal may fall, all others "
        "fixed, and the game is still solved. Orders: sequences of blocks for which a plan that solves is known, "
        "of all. The search is float32; enumerations, and what it found, are float64. It ends where no change of one "
        f"removal of a best plan, and none of two by up to {PAIR_STEPS} steps, is better. Plans begin at step 1, as of "
        "people and of agents that plan ahead; one that acts on the fly can remove a block before any step is made, "
        "which may gain a step. A game counts as impossible only as far as its plans were enumerated.",
    ]
    for fps, rows in tables.items():
        missing = [game for game in GAMES if game not in rows]
        parts.append(f"## {fps} steps a second, reset {RESETS[fps]}, float64")
        if missing:
            parts.append(f"Still missing: {', '.join(missing)}.")
        if rows:
            parts += [_split_table(rows, fps), _game_table(rows)]
    return "\n\n".join(parts) + "\n"


def _split_table(rows: Mapping[str, Row], fps: int) -> str:
    """Mean reward and solved games by split, beside the paper's oracle, who played at 60."""
    reward = by_split({game: row["reward"] for game, row in rows.items()})
    solved = by_split({game: float(row["solved"]) for game, row in rows.items()})
    cells = [["found", *(f"{reward[s]:.1f}, {100 * solved[s]:.0f} %" if s in reward else "-" for s in COLUMNS)]]
    if fps != DECISIONS_PER_SECOND:
        stated = paper_numbers()["agents"]["Oracle"]
        cells.append(["paper", *(f"{stated[split][0]:.1f}, {stated[split][1]:.0f} %" for split in COLUMNS)])
    return markdown_table(["oracle", *(TITLES[split] for split in COLUMNS)], cells)


def _game_table(rows: Mapping[str, Row]) -> str:
    """One line a game."""
    cells = []
    for game, row in rows.items():
        blocks = len(load_scene(game).eliminable_blocks)
        cells.append(
            [
                game,
                f"{row['reward']:.2f}" if row["solved"] else "none found",
                str(len(row["order"])) if row["solved"] else "-",
                f"{row['seconds']:.2f}",
                " ".join(str(step) if step >= 0 else "-" for step in row["plan"]) if row["solved"] else "-",
                " ".join("-" if width is None else f"{width:.2f}" for width in row["slack"] or []) or "-",
                f"{len(row['orders'])} of {len(possible_orders(blocks))}",
                ", ".join(row["enumerated"]),
            ]
        )
    header = ["game", "reward", "removals", "s", "plan, steps", "slack, s", "orders found", "enumerated"]
    return markdown_table(header, cells)
