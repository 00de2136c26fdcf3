"""Which plays a batch has: each once, drawn one by one, or many of a scene."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

from iphyre_jax.models.outcome.batches import epoch_batches
from iphyre_jax.models.outcome.plays.inputs import Examples, Plans
from iphyre_jax.models.outcome.settings import settings


def plays(game: list[int], label: list[int]) -> Examples:
    """Plays without plans."""
    none, weight = np.zeros((len(game), 12), np.float32), np.ones(len(game), np.float32)
    return Examples(np.array(game, np.int32), Plans(none, none), np.array(label, np.int32), weight)


def test_an_epoch_reads_each_play_once_and_a_short_last_batch() -> None:
    config = dataclasses.replace(settings("clean", "plan"), batch_size=16)
    index, counts = epoch_batches(config, jax.random.key(0), plays([0] * 41, [0] * 41), 1)
    assert index.shape == counts.shape == (3, 16)
    assert sorted(np.asarray(index)[np.asarray(counts) > 0].tolist()) == list(range(41))


def test_drawn_plays_are_balanced() -> None:
    config = dataclasses.replace(settings("relations"), draws=50_000, batch_size=100, basic_share=0.0)
    # Scene 0 has 900 failures and 100 successes, scene 1 has ten failures.
    found = plays([0] * 1000 + [1] * 10, [0] * 900 + [1] * 100 + [0] * 10)
    index, counts = epoch_batches(config, jax.random.key(0), found, 2)
    assert index.shape == (500, 100)
    assert np.asarray(counts).all()
    drawn = np.bincount(np.asarray(index).ravel(), minlength=1010)
    assert drawn.min() > 0
    shares = np.array([drawn[:900].sum(), drawn[900:1000].sum(), drawn[1000:].sum()]) / drawn.sum()
    np.testing.assert_allclose(shares, [0.25, 0.25, 0.5], atol=0.02)


def test_a_share_of_the_draws_is_of_the_basic_games() -> None:
    config = dataclasses.replace(settings("relations"), draws=20_000, batch_size=100, basic_share=0.25)
    found = plays(list(range(40)), [0] * 40)
    drawn = np.bincount(np.asarray(epoch_batches(config, jax.random.key(0), found, 40)[0]).ravel(), minlength=40)
    np.testing.assert_allclose(drawn / drawn.sum(), [0.25 / 10 + 0.75 / 40] * 10 + [0.75 / 40] * 30, atol=0.004)


def test_each_of_a_million_plays_can_be_drawn() -> None:
    config = dataclasses.replace(settings("relations"), draws=200_000, batch_size=1000, basic_share=0.0)
    count = 500_000  # of each of two scenes
    found = plays([0] * count + [1] * count, [0] * 2 * count)
    drawn = np.asarray(epoch_batches(config, jax.random.key(0), found, 2)[0]).ravel()
    different = len(np.unique(drawn)) / len(drawn)
    assert abs(different - (1 - np.exp(-0.2)) / 0.2) < 0.005  # as many as of independent draws


def test_plays_of_a_scene_stand_together_and_half_of_them_solve_it() -> None:
    config = dataclasses.replace(settings("ranker"), draws=4000, batch_size=40, plans_per_scene=8)
    # In no order; scene 1 has one success in 100 plays, scene 2 none.
    game = np.random.default_rng(0).permutation(np.repeat([0, 1, 2], 100))
    label = (game == 0) & (np.random.default_rng(1).random(300) < 0.3)
    label[np.flatnonzero(game == 1)[50]] = True
    index, counts = epoch_batches(config, jax.random.key(0), plays(game.tolist(), label.astype(int).tolist()), 3)
    index = np.asarray(index)
    assert index.shape == counts.shape == (100, 5, 8)
    scene = game[index]
    assert (scene == scene[..., :1]).all()
    assert np.bincount(scene[..., 0].ravel()).min() > 130  # of 500: scenes are drawn alike
    assert [abs(label[index][scene == k].mean() - share) < 0.05 for k, share in enumerate((0.5, 0.5, 0.0))] == [
        True
    ] * 3
    assert len(np.unique(index)) == 100 + len(np.unique(index[scene == 1])) + 100 > 250
