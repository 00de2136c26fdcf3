"""Labels against numbers worked by hand, those of the paper's code with their faults."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from iphyre_jax.models.sequence.episodes import episodes, shares
from iphyre_jax.models.sequence.networks import END, NEVER_BIN
from iphyre_jax.models.sequence.settings import settings
from tests.models.sequence.made_up import made_up


def test_plans_in_advance() -> None:
    data = episodes(made_up(), settings("paper"))
    assert data.returns[:, 0] == pytest.approx([1 - 0.02 - 0.004, -0.01 - 0.015, 1 - 0.02 - 0.005, -0.015])
    np.testing.assert_array_equal(data.actions[:, 0, :3], [[5, 20, 150], [150, 10, 150], [30, 12, 150], [150] * 3])
    np.testing.assert_array_equal(data.weight[:, 0].sum(axis=1), [2, 2, 3, 3])  # blocks of the scene
    assert data.tables.shape == (2, 12, 9)


def test_the_code_reverses_the_return_in_advance() -> None:
    data = episodes(made_up(), settings("paper-as-coded"))
    np.testing.assert_array_equal(data.returns[:, 0], [0, 1, 0, 1])


def test_events() -> None:
    plays = made_up()
    data = episodes(plays, settings("ours"))
    one, two = plays.scenes[0].eliminable_blocks, plays.scenes[1].eliminable_blocks
    assert data.actions[0, :3].tolist() == [[one[0], 5], [one[1], 15], [END, 0]]
    assert data.actions[2, :3].tolist() == [[two[1], 12], [two[0], 18], [END, 0]]
    assert data.actions[3, 0].tolist() == [END, 0]
    np.testing.assert_array_equal(data.time[2, :3], [0, 12, 30])
    assert data.returns[2, :3] == pytest.approx([0.975, 0.975 + 0.01 + 0.0012, 0.975 + 0.02 + 0.003])
    np.testing.assert_array_equal(data.length, [3, 2, 3, 1])
    np.testing.assert_array_equal(data.weight[0, :4], [[1, 1], [1, 1], [1, 0], [0, 0]])  # no delay after END


def test_events_see_the_state_after_each_removal() -> None:
    plays = made_up(poses=True)
    data = episodes(plays, settings("ours", "combined"))
    mover = int(np.flatnonzero(plays.scenes[1].dynamic)[0])
    rows = np.asarray(data.tables)[data.table[2, :3]]
    centre = rows[:, mover, [0, 2]].mean(axis=1) * 600
    np.testing.assert_allclose(centre, [100, 113, 131], atol=1e-3)  # at the start, then the frame after a removal
    block = plays.scenes[1].eliminable_blocks[1]
    assert rows[0, block].any()
    assert not rows[1:, block].any()


def test_combined_learns_what_is_left() -> None:
    data = episodes(made_up(poses=True), settings("paper", "combined"))
    np.testing.assert_array_equal(data.weight[2, :4, :3], [[1, 1, 1], [1, 0, 1], [0, 0, 1], [0, 0, 0]])
    coded = episodes(made_up(poses=True), settings("paper-as-coded", "combined"))
    np.testing.assert_array_equal(coded.actions[1, 0, :3], [1, 5, 1])  # halved; what stays goes at 0.1 s
    np.testing.assert_array_equal(coded.time[0, :6], [1, 1, 1, 1, 2, 10])
    assert (coded.returns == 1).all()


def test_choices_on_the_fly() -> None:
    plays = made_up(10, poses=True)
    data = episodes(plays, settings("paper", "on-the-fly"))
    assert data.actions.shape == (4, 150, 1)
    assert np.flatnonzero(data.actions[2, :, 0]).tolist() == [12, 30]
    assert data.actions[2, [12, 30], 0].tolist() == [2, 1]
    np.testing.assert_array_equal(data.length, [40, 150, 50, 150])
    acts = np.asarray(data.actions[..., 0]) > 0
    assert data.weight[acts].sum() == pytest.approx(data.weight[~acts].sum(), rel=1e-5)
    assert data.returns[0, [0, 5, 6]] == pytest.approx([0.976, 0.9765, 0.9866])
    coded = episodes(plays, settings("paper-as-coded", "on-the-fly"))
    assert (coded.returns == 1).all()
    assert set(np.unique(coded.weight)) == {0, 1}


def test_shares() -> None:
    plays = made_up()
    config = dataclasses.replace(settings("ours"), solved_share=0.8)
    assert shares(plays, config) == pytest.approx([0.4, 0.1, 0.4, 0.1])
    assert shares(plays, settings("clone-solved")) == pytest.approx([0.5, 0, 0.5, 0])
    assert shares(plays, settings("clone-all")) == pytest.approx([0.25] * 4)
    assert NEVER_BIN == 150
