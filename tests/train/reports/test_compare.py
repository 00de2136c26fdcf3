"""Rows side by side, against numbers worked out by hand."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.printing import print_table
from iphyre_jax.train.settings.run import TrainConfig, preset


def run(config: TrainConfig, seed: int, reward: float, games: tuple[str, ...] = GAMES) -> compare.Evaluated:
    """A run with the same score at each game."""
    score = {"reward": reward, "success": 1.0}
    played = {name: {"greedy": score, "sampled": score} for name in games}
    own = dataclasses.replace(config, seed=seed)
    return compare.Evaluated(Path(f"seed-{seed}"), own, played, config.updates)


def test_a_difference_is_paired_by_seed() -> None:
    config = preset("ppo", "combined")
    one = compare.rows([run(config, 0, 10.0), run(config, 1, 20.0), run(config, 2, 1000.0)])[0]
    other = compare.rows([run(config, 1, 5.0), run(config, 0, 3.0)])[0]
    found = compare.difference(one, other, "sampled", "all")
    assert found is not None
    assert (found.mean, found.seeds) == (11.0, 2)
    assert found.high - found.mean == found.mean - found.low == pytest.approx(12.7062 * 4.0)  # 7 and 15, Student's t


def test_nothing_in_common_is_no_difference() -> None:
    config = preset("ppo", "combined")
    one, other = (compare.rows([run(config, seed, 1.0, SPLITS["basic"])])[0] for seed in (0, 1))
    assert compare.difference(one, other, "sampled", "basic") is None
    assert compare.difference(one, one, "sampled", "all") is None  # the forty were not played
    own = compare.difference(one, one, "greedy", "basic")
    assert own is not None
    assert own.mean == 0
    assert np.isnan(own.low)


def test_rows_of_one_name_tell_how_they_differ() -> None:
    config = preset("ppo", "in-advance", "quick")
    changed = dataclasses.replace(config, resets=1, updates=7)
    other = preset("ppo", "combined")
    names = compare.names(compare.rows([run(one, 0, 1.0) for one in (config, changed, other)]))
    assert names[0] == f"PPO-I quick, {config.head}, official, resets {config.resets}, updates {config.updates}"
    assert names[1] == f"PPO-I quick, {config.head}, official, resets 1, updates 7"
    assert names[2] == compare.rows([run(other, 0, 1.0)])[0].name


def test_a_policy_from_the_middle_of_a_run_has_a_row_of_its_own() -> None:
    config = preset("ppo", "combined")
    middle = dataclasses.replace(run(config, 1, -15.0), updates=3)
    whole, part = compare.rows([run(config, 0, 900.0), middle, run(config, 2, 902.0)])
    assert [seed.config.seed for seed in whole.seeds] == [0, 2]
    assert part.name == f"{whole.name}, 3 of {config.updates} updates"
    assert [cells[1] for cells in compare.table([whole, part], "greedy")[:2]] == ["2", "1"]


def test_seeds_share_the_contents_of_their_scene_files() -> None:
    """Wherever the files lay; a file that was edited is another scene."""
    config = dataclasses.replace(preset("ppo", "in-advance", "quick"), games=("/a/mine.json",))
    elsewhere = dataclasses.replace(config, games=("/b/mine.json",))
    same = [
        dataclasses.replace(run(one, seed, 1.0), scenes=("1" * 64, "2" * 64))
        for seed, one in enumerate((config, elsewhere))
    ]
    edited = dataclasses.replace(run(config, 2, 1.0), scenes=("1" * 64, "3" * 64))
    rows = compare.rows([*same, edited])
    assert [len(row.seeds) for row in rows] == [2, 1]
    name = f"PPO-I quick, {config.head}, official, on mine.json"
    assert compare.names(rows) == [f"{name}, scenes 11111111 22222222", f"{name}, scenes 11111111 33333333"]


def test_seeds_share_a_pool_wherever_it_lies() -> None:
    pooled = dataclasses.replace(preset(), pool_sha256="1" * 64)
    one, two = (dataclasses.replace(pooled, scene_pool=path) for path in ("data/pool.npz", "/moved/data/pool.npz"))
    other = dataclasses.replace(one, pool_sha256="2" * 64)
    rows = compare.rows([run(config, seed, 1.0) for seed, config in enumerate((one, two, other))])
    assert [len(row.seeds) for row in rows] == [2, 1]


def test_rates_never_share_a_table() -> None:
    config = preset("ppo", "combined")
    with pytest.raises(ValueError, match=r"expected one frame rate, got 10, 60"):
        compare.rows([run(config, 0, 1.0), run(dataclasses.replace(config, fps=60), 0, 1.0)])


@pytest.mark.parametrize(("width", "terminal"), [(80, False), (0, False), (20, True), (60, True)])
def test_a_table_keeps_all_columns_at_any_width(width: int, terminal: bool) -> None:
    table = Table("game", "eliminable blocks", "balls")
    table.add_row("multi_ball_spring_flick", "0: (100, 200) (300, 200)", "2")
    console = Console(file=io.StringIO(), width=width, force_terminal=terminal, color_system=None)
    print_table(console, table)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for word in ("game", "_flick", "eliminable", "blocks", "200)", "balls"):
        assert word in text
    assert terminal or "multi_ball_spring_flick │ 0: (100, 200) (300, 200) │ 2" in text
    assert console.width == width
