"""How decisions become removals, with a made-up model: nothing is compiled, nothing is played."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.models.sequence import agent
from iphyre_jax.models.sequence.networks import END, NEVER_BIN, Sequences
from iphyre_jax.models.sequence.settings import SequenceConfig, settings
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import load_scene

HINDER = load_scene("hinder")  # three blocks that can go
NAN = float("nan")
Script = Callable[[int, Sequences], list[list[int]]]


@pytest.fixture
def player(monkeypatch: pytest.MonkeyPatch) -> Callable[[SequenceConfig, Script], agent.Player]:
    """A player of one world of hinder whose actions a script gives, by the number of the decision."""

    def tables(scenes: object, game: np.ndarray, steps: np.ndarray, protocol: object) -> np.ndarray:
        table = np.zeros((len(game), 150, 12, 9))
        table[..., 0, 0] = np.arange(150)  # px: the tenth of a second
        table[..., 0, 1] = (steps >= 0).sum(axis=1)[:, None]  # px: removals planned so far
        return table

    def make(config: SequenceConfig, script: Script) -> agent.Player:
        counted = iter(range(1000))

        def decide(config: object, params: object, inputs: Sequences, k: object, *rest: object) -> np.ndarray:
            action = np.zeros((len(inputs.time), *inputs.actions.shape[2:]), np.int32)
            action[:1] = script(next(counted), inputs)
            return action

        monkeypatch.setattr(agent, "decide", decide)
        monkeypatch.setattr(agent, "play_tables", tables)
        return agent.Player(config, None, [HINDER], np.zeros(1, int))

    return make


def test_plans_in_advance(player: Callable[..., agent.Player]) -> None:
    made = player(settings("paper"), lambda k, inputs: [[5, NEVER_BIN, 20, 7, 8, 9]])
    np.testing.assert_array_equal(made.plans()[0], [0.5, NAN, 2.0, NAN, NAN, NAN])  # there are three slots
    assert made.steps()[0].tolist() == [31, -1, 121, -1, -1, -1]  # the official clock is late by its rounding


def test_events_follow_one_another(player: Callable[..., agent.Player]) -> None:
    first, second, _ = HINDER.eliminable_blocks
    inputs: list[Sequences] = []
    actions = [[second, 12], [first, 18], [END, 0]]

    def script(k: int, given: Sequences) -> list[list[int]]:
        inputs.append(given)
        return [actions[k]]

    made = player(settings("ours", "combined"), script)
    np.testing.assert_array_equal(made.plans()[0, :3], [3.0, 1.2, NAN])
    last = inputs[-1]
    np.testing.assert_array_equal(last.time[0, :3], [0, 12, 30])
    assert np.asarray(last.returns[0, :3]) == pytest.approx([0.985, 0.985 + 0.01 + 0.0012, 0.985 + 0.02 + 0.003])
    np.testing.assert_allclose(last.rows[0, 1:3, 0, 0] * 600, [13, 31], rtol=1e-5)  # after the frame of a removal
    np.testing.assert_allclose(last.rows[0, 1:3, 0, 1] * 600, [1, 2], rtol=1e-5)


def test_combined_plays_to_the_next_removal(player: Callable[..., agent.Player]) -> None:
    # The first plan's earliest is slot 1; the second plan moves slot 0 behind slot 2; what is past does nothing.
    actions = [[30, 12, 40, 1, 1, 1], [60, 12, 40, 1, 1, 1], [20, 12, 40, 1, 1, 1]]
    made = player(settings("paper", "combined"), lambda k, inputs: [actions[k]])
    np.testing.assert_array_equal(made.plans()[0, :3], [NAN, 1.2, 4.0])


def test_choices_on_the_fly(player: Callable[..., agent.Player]) -> None:
    config = dataclasses.replace(settings("paper", "on-the-fly"), context=4)
    inputs: list[Sequences] = []

    def script(k: int, given: Sequences) -> list[list[int]]:
        inputs.append(given)
        return [[{0: 2, 30: 1, 31: 1, 40: 5}.get(k, 0)]]  # 31: it is gone; 40: there is no such block

    made = player(config, script)
    np.testing.assert_array_equal(made.plans()[0, :3], [3.0, 0.0, NAN])
    assert made.steps()[0].tolist() == [30, 0, -1, -1, -1, -1]  # before the first step, as in the environment
    assert len(inputs) == 150
    np.testing.assert_array_equal(inputs[50].time[0], [47, 48, 49, 50])
    np.testing.assert_allclose(inputs[50].rows[0, :, 0, 0] * 600, [47, 48, 49, 50], rtol=1e-5)
    assert float(inputs[50].returns[0, -1]) == pytest.approx(0.985 + 2 * 0.01 + 50 * 0.0001, abs=1e-5)


def test_contrast_compares_with_a_failure(player: Callable[..., agent.Player], monkeypatch: pytest.MonkeyPatch) -> None:
    made = player(settings("ours"), lambda k, inputs: [[HINDER.eliminable_blocks[0], 50] if k == 0 else [END, 0]])
    made.plans()
    monkeypatch.setattr(agent, "_likelihood", lambda config, params, inputs, made: (inputs.returns * made).sum(axis=1))
    # Asked: 0.985 and, after a removal at 5 s, 1.0. A failure has one removal and 15 s before it, then 10 s.
    assert agent.contrast(made)[0] == pytest.approx(0.985 + 1.0 - (-0.025 - 0.010))
    # A second removal at 15.1 s never comes, and nothing that the model says after it counts.
    first, second = HINDER.eliminable_blocks[:2]
    made = player(settings("ours"), lambda k, inputs: [[[first, 50], [second, 101], [first, 1]][min(k, 2)]])
    made.plans()
    assert agent.contrast(made)[0] == pytest.approx(0.985 + 1.0 - (-0.025 - 0.010))


def test_one_program_for_any_number_of_worlds() -> None:
    parts = list(agent.blocks(agent.BLOCK + 3))
    assert [count for _, count in parts] == [agent.BLOCK, 3]
    assert [len(index) for index, _ in parts] == [agent.BLOCK] * 2
    assert parts[1][0][:4].tolist() == [agent.BLOCK, agent.BLOCK + 1, agent.BLOCK + 2, 0]


def test_a_block_goes_if_that_is_likelier_than_not() -> None:
    chance = np.full((1, 2, 151), 0.6 / 150)
    chance[0, 0, NEVER_BIN], chance[0, 0, 42] = 0.39, 0.02  # never is the likeliest number, and less likely than to go
    chance[0, 1, NEVER_BIN] = 2.0
    assert agent.likeliest_times(jnp.log(jnp.asarray(chance, jnp.float32))).tolist() == [[42, NEVER_BIN]]


@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly"])
def test_tries_take_the_steps_of_the_model(monkeypatch: pytest.MonkeyPatch, strategy: StrategyName) -> None:
    """At 10 steps a second too, whose rule is another one than that of the attempts; but none before the first."""
    bins = np.array([[8, 11, 149, NEVER_BIN, NEVER_BIN, NEVER_BIN]] * 2)
    bins[1, 0] = 0 if strategy == "on-the-fly" else 1

    def plans(player: agent.Player) -> None:
        player.bins = bins

    monkeypatch.setattr(agent.Player, "plans", plans)
    for fps in (10, 60):
        config = dataclasses.replace(settings("ours", strategy), fps=fps)
        propose = agent.SequenceTries(config, None)
        made = plan_to_steps(propose(HINDER, 2, np.random.default_rng(0), ("earlier",)), fps, "simulate")
        player = agent.Player(config, None, [HINDER], np.zeros(2, int))
        player.bins = bins
        np.testing.assert_array_equal(made, np.where(player.steps() == 0, 1, player.steps())[:, :3])


def test_tries_begin_with_the_greedy_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, _ = HINDER.eliminable_blocks
    asked: list[tuple[int, bool]] = []

    def decide(
        config: object, params: object, inputs: Sequences, k: object, sampled: object, key: object
    ) -> np.ndarray:
        action = np.full((len(inputs.time), 2), END, np.int32)
        if int(np.asarray(k)) == 0:
            asked.append((len(inputs.time), bool(sampled)))
            action[:] = (second, 12) if sampled else (first, 5)
        return action

    monkeypatch.setattr(agent, "decide", decide)
    monkeypatch.setattr(agent, "play_tables", lambda scenes, game, *_: np.zeros((len(game), 150, 12, 9)))
    config = dataclasses.replace(settings("ours"), data="large")
    propose = agent.SequenceTries(config, None)
    rng = np.random.default_rng(0)
    greedy, drawn = [30.5 / 60, NAN, NAN], [NAN, 71.5 / 60, NAN]  # steps 31 and 72, by the official clock
    np.testing.assert_array_equal(propose(HINDER, 3, rng, ()), [greedy, drawn, drawn])
    assert [sampled for _, sampled in asked] == [False, True]
    np.testing.assert_array_equal(propose(HINDER, 1, rng, ()), [greedy])
    np.testing.assert_array_equal(propose(HINDER, 2, rng, ("earlier",)), [drawn, drawn])  # not the greedy one again
