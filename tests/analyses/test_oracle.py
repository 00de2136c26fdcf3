from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import GAMES, load_scene, simulate
from iphyre_jax.analyses import oracle, people, slack
from iphyre_jax.analyses.orders import executed_order, possible_orders


@pytest.mark.parametrize("fps", oracle.RATES)
def test_shipped_data_is_whole_and_agrees_with_itself(fps: int) -> None:
    rows = oracle.shipped(fps)
    assert tuple(rows) == GAMES
    for game, row in rows.items():
        last, blocks = round(row["seconds"] * fps), len(load_scene(game).eliminable_blocks)
        assert len(row["plan"]) == blocks
        assert executed_order(np.array(row["plan"]), last) == tuple(row["order"])
        if row["solved"]:
            assert row["reward"] == pytest.approx(1000 - 10 * len(row["order"]) - row["seconds"])
            assert tuple(row["order"]) in oracle.orders_of(row)
            assert [width is not None for width in row["slack"]] == [step >= 0 for step in row["plan"]]
            assert [width is not None for width in row["widest_slack"]] == [step >= 0 for step in row["widest_plan"]]
            widest, best = slack.least_slack(row["widest_slack"]), slack.least_slack(row["slack"])
            assert widest is None if () in oracle.orders_of(row) else widest >= best
        assert oracle.orders_of(row) <= set(possible_orders(blocks))
        for found in row["orders"]:
            assert executed_order(np.array(found["plan"]), 15 * fps) == tuple(found["order"])


@pytest.mark.parametrize("fps", oracle.RATES)
def test_shipped_plans_of_a_game_come_out(fps: int) -> None:
    row = oracle.shipped(fps)["support"]
    plans = [row["plan"], *(found["plan"] for found in row["orders"])]
    played = simulate("support", plans, fps=fps, resets=oracle.RESETS[fps], dtype="float64")
    assert played.success.all()
    assert played.reward[0] == row["reward"]


def test_export_is_what_is_read(tmp_path: Path) -> None:
    file = tmp_path / "oracle-10fps.json"
    rows = oracle.shipped(10)
    oracle.export(rows, 10, file)
    assert file.read_bytes() == oracle.file_of(10).read_bytes()


def test_smallest_slack() -> None:
    assert slack.least_slack([0.5, None, 0.2]) == 0.2
    assert slack.least_slack([None]) is None
    assert slack.least_slack(None) is None


def test_games_of_like_slack_are_of_one_range() -> None:
    least = {"a": 0.5, "b": 0.4, "c": 0.5, "d": 7.0, "e": 2.0}
    assert slack.ranges(least) == {
        "below 0.5 s (1 of 5)": ["b"],
        "0.5 to 2 s (2 of 5)": ["a", "c"],
        "2 s or more (2 of 5)": ["d", "e"],
    }
    assert list(slack.ranges({"a": 1.0})) == ["0.5 to 2 s (1 of 1)"]


def test_derived_share_of_people_lies_between_none_and_all() -> None:
    rates = people.success_rates()
    assert all(0 < rate < 1.01 for rate in rates.values())
    # By hand: (975.96 + 40) / (977.7 + 40) in support, whose best plan takes two removals and 2.3 s
    assert rates["support"] == pytest.approx(1015.96 / 1017.7, abs=1e-4)
