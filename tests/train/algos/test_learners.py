"""Every algorithm on probes with known answers, its pieces against hand-worked numbers."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.train.algos import actor_critic, ddpg, dqn, ppo, sac
from iphyre_jax.train.algos.registry import ALGORITHMS, algorithm
from iphyre_jax.train.algos.replay import Transition
from iphyre_jax.train.settings.agents import A2C, DDPG, DQN, PPO, SAC, Settings
from iphyre_jax.train.settings.presets import PRESETS, preset
from iphyre_jax.train.settings.run import AGENTS, TrainConfig
from tests.train.algos.probes import Probe, first_state, fitted, greedy_actions, learned, observations, play

PLANNING: dict[str, tuple[Settings, dict[str, Any]]] = {
    "ppo slots": (PPO(learning_rate=3e-3), {"head": "slots"}),
    "ppo gaussian": (PPO(learning_rate=3e-3), {"head": "gaussian"}),
    "a2c slots": (A2C(learning_rate=3e-3, minibatches=8), {"head": "slots"}),
    "sac": (SAC(learning_rate=3e-3, warmup=100, steps=32, batch=128), {"head": "squashed"}),
    "ddpg": (DDPG(learning_rate=3e-3, warmup=100, steps=32, batch=128, noise_rounds=40), {"head": "point"}),
}
CRITIC: dict[str, Any] = {"critic": True, "rows": 256, "learning_rate": 3e-3, "trace": 0.9}
FLYING: dict[str, Settings] = {
    "ppo": PPO(**CRITIC),
    "a2c": A2C(**CRITIC, minibatches=8),
    "sac": SAC(learning_rate=3e-3, warmup=100, steps=32, batch=128, target_entropy=0.2, alpha=0.01, target_rate=0.05),
    "dqn": DQN(learning_rate=3e-3, warmup=100, steps=32, batch=128, epsilon_rounds=20, idle=0.5, target_rate=0.05),
}


def planner(name: str, **settings: Any) -> TrainConfig:
    learner, given = PLANNING[name]
    agent: Any = name.split()[0]
    return TrainConfig(
        agent=agent, learner=learner, hidden=(32,), updates=40, episodes_per_scene=64, **given | settings
    )


def flyer(name: str, **settings: Any) -> TrainConfig:
    agent: Any = name
    return TrainConfig(
        agent=agent,
        strategy="on-the-fly",
        head="even",
        observation="motion",
        learner=FLYING[name],
        hidden=(32,),
        updates=40,
        episodes_per_scene=64,
        **settings,
    )


GOALS = np.array([4.0, 11.0])  # s


def early_or_late(scene: np.ndarray, k: int, action: np.ndarray, good: np.ndarray) -> np.ndarray:
    """One decision; scene 0 pays for block 0 at 4 s, scene 1 at 11 s, the less the farther off."""
    return 1000.0 * np.exp(-np.square((15 * action[:, 0] - GOALS[scene]) / 2.5))


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNING)
def test_what_is_seen_decides_when(name: str) -> None:
    probe = Probe(("support", "spring"), 1, early_or_late)
    config = planner(name)
    np.testing.assert_allclose(greedy_actions(config, probe, learned(config, probe))[0, :, 0], GOALS, atol=1.5)


def right_so_far(k: int, action: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Nothing at the first decision, block 0 at the second, anything at the third; it is seen whether all was right."""
    return good & ((action == k) | (k == 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", FLYING)
def test_what_pays_later_is_learned(name: str) -> None:
    """Needs values that look ahead: a reward two decisions later is due to this one."""
    probe = Probe(("support",), 3, lambda scene, k, _, good: 1000.0 * (good & (k == 2)), right_so_far)
    config = flyer(name)
    np.testing.assert_array_equal(greedy_actions(config, probe, learned(config, probe))[:2, 0], [0, 1])


@pytest.mark.slow
def test_never_pays() -> None:
    """Every removal costs 10 and nothing succeeds: the best plan removes nothing."""
    probe = Probe(("seesaw", "support"), 1, lambda _, __, a, ___: -15 - 10.0 * (a[:, :2] > 0).sum(axis=1))
    config = planner("ppo slots")
    np.testing.assert_array_equal(greedy_actions(config, probe, learned(config, probe))[0, :, :2], 0)


@pytest.mark.slow
def test_small_differences_count_within_a_scene() -> None:
    """One scene pays 1000, the other never does: a difference of 10 in the first is still learned."""
    probe = Probe(
        ("support", "seesaw"), 1, lambda scene, _, a, __: np.where(scene == 0, 1000.0 - 10 * (a[:, 1] > 0), -15.0)
    )
    config = planner("ppo slots")
    assert greedy_actions(config, probe, learned(config, probe))[0, 0, 1] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("agent", "discount"), [("ppo", 0.5), ("dqn", 0.5)])
def test_values_are_discounted_sums(agent: str, discount: float) -> None:
    """400 points in each of three decisions, whatever is done: 0.4 (1 + d + d^2), 0.4 (1 + d), 0.4."""
    probe = Probe(("support",), 3, lambda scene, *_: np.full(len(scene), 400.0))
    config = flyer(agent)
    config = dataclasses.replace(config, learner=dataclasses.replace(config.learner, discount=discount))
    state, seen = learned(config, probe), jnp.asarray(observations(config, probe)[:3, 0])
    if agent == "dqn":
        found = dqn.values(config, state.learned.value, seen)[:, :3].max(axis=-1)
    else:
        found = actor_critic.value(config, state.params, seen)
    np.testing.assert_allclose(found, [0.7, 0.6, 0.4], atol=0.06)


def test_clipped_objective_by_hand() -> None:
    """The better ratio is only rewarded up to 1.2, the worse one only spared down to 0.8."""
    ratio = jnp.array([1.5, 1.5, 0.5, 0.5, 1.1])
    advantage = jnp.array([2.0, -2.0, 2.0, -2.0, 3.0])
    np.testing.assert_allclose(ppo.clipped_objective(ratio, advantage, 0.2), [2.4, -3.0, 1.0, -1.6, 3.3], rtol=1e-6)


def batch_for(config: TrainConfig, state: Any, advantage: list[float]) -> tuple[jax.Array, actor_critic.Batch]:
    seen = jnp.asarray(observations(config, Probe(("support", "hole"), 1, early_or_late))[0])
    row = jnp.array([0, 0, 1, 1])
    act = jax.jit(actor_critic.act, static_argnums=0)
    decision = act(config, state.params, jax.random.key(5), seen[row])
    gain, there = jnp.asarray(advantage), jnp.array([1.0, 1.0, 1.0, 0.0])
    return seen, actor_critic.Batch(row, decision.choice, decision.log_prob, gain, gain, there)


def test_ppo_loss_before_the_first_step() -> None:
    """All ratios are 1: minus the mean advantage of what was there, minus the weighted entropy; nothing is clipped."""
    config = planner("ppo slots")
    state = first_state(config, jax.random.key(0))
    seen, batch = batch_for(config, state, [1.0, -0.5, 2.0, 100.0])
    zero = jnp.zeros(())
    value, metrics = ppo.loss(state.params, config, seen, batch, zero, zero)
    np.testing.assert_allclose(value, -2.5 / 3, rtol=1e-5)
    np.testing.assert_allclose([metrics["kl"], metrics["clipped"]], [0.0, 0.0], atol=1e-6)
    weighted, _ = ppo.loss(state.params, config, seen, batch, jnp.float32(0.5), zero)
    np.testing.assert_allclose(weighted, -2.5 / 3 - 0.5 * float(metrics["entropy"]), rtol=1e-5)


def test_ppo_loss_of_another_policy_by_hand() -> None:
    """Plans that were half as probable when they were sampled: ratio 2, beyond the clip range."""
    config = planner("ppo slots")
    state = first_state(config, jax.random.key(0))
    seen, batch = batch_for(config, state, [1.0, 1.0, -1.0, 7.0])
    batch = batch._replace(log_prob=batch.log_prob - math.log(2))
    value, metrics = ppo.loss(state.params, config, seen, batch, jnp.zeros(()), jnp.float32(0.1))
    kl = 2 - 1 - math.log(2)
    np.testing.assert_allclose(value, -(1.2 + 1.2 - 2.0) / 3 + 0.1 * kl, rtol=1e-4)
    np.testing.assert_allclose([metrics["kl"], metrics["clipped"]], [kl, 1.0], rtol=1e-4)


@pytest.mark.parametrize("network", ["perceptron", "objects"])
def test_an_observation_of_many_decisions_is_seen_once(network: Any) -> None:
    """Loss and gradient are those of the same observation given anew for each decision."""
    config = planner("ppo slots", network=network)
    state = first_state(config, jax.random.key(0))
    seen, batch = batch_for(config, state, [1.0, -0.5, 2.0, 100.0])
    one_each = batch._replace(row=jnp.arange(4))
    differentiated = jax.jit(jax.value_and_grad(ppo.loss, has_aux=True), static_argnums=1)
    few = differentiated(state.params, config, seen, batch, jnp.float32(0.5), jnp.zeros(()))
    many = differentiated(state.params, config, seen[batch.row], one_each, jnp.float32(0.5), jnp.zeros(()))
    for one, other in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


def test_the_weight_of_the_divergence_adapts() -> None:
    settings = PPO(kl_weight=0.2, kl_target=0.01)
    far, near, right = (float(ppo._adapted(settings, jnp.float32(0.2), jnp.float32(kl))) for kl in (0.03, 0.004, 0.01))
    np.testing.assert_allclose([far, near, right], [0.3, 0.1, 0.2], rtol=1e-6)


def transition_of(config: TrainConfig, choice: jax.Array, discount: float) -> Transition:
    seen = jnp.asarray(observations(config, Probe(("support",), 1, early_or_late))[0])
    return Transition(seen, choice, jnp.array([0.5]), jnp.array([discount]), seen, jnp.ones(1))


def test_dqn_target_by_hand() -> None:
    """Chosen by the learned network, valued by the target's: 0.5 + 0.9 Q'(argmax Q)."""
    config = flyer("dqn")
    learner = first_state(config, jax.random.key(0)).learned
    learner = learner._replace(target=first_state(config, jax.random.key(1)).learned.value)
    batch = transition_of(config, jnp.array([0]), 0.9)
    chosen = int(dqn.values(config, learner.value, batch.following).argmax())
    judged = dqn.values(config, learner.target, batch.following)[0, chosen]
    np.testing.assert_allclose(dqn.targets(config, learner, batch), [0.5 + 0.9 * float(judged)], rtol=1e-5)
    assert chosen <= 2  # support has two blocks; the other slots have no value
    assert float(dqn.targets(config, learner, batch._replace(discount=jnp.zeros(1)))[0]) == 0.5


def test_discrete_sac_target_by_hand() -> None:
    """0.5 + 0.9 sum_a pi(a) (min Q'(a) - alpha log pi(a)) over the three actions that support has."""
    config = flyer("sac")
    learner = first_state(config, jax.random.key(0)).learned
    batch = transition_of(config, jnp.array([0]), 0.9)
    share = np.array([1 / 7, 3 / 7, 3 / 7])  # the head's prior: the policy's last layer is next to nothing at the start
    values = np.asarray(sac._values(config, learner.target, batch.following, batch.choice)).min(axis=0)[0, :3]
    soft = (share * (values - 0.01 * np.log(share))).sum()
    np.testing.assert_allclose(sac.targets(config, learner, jax.random.key(3), batch), [0.5 + 0.9 * soft], atol=2e-3)


@pytest.mark.slow
def test_sac_holds_its_entropy() -> None:
    """Block 0 pays 300 points; alpha brings the entropy of the policy to the target, and no lower."""
    learner = SAC(learning_rate=3e-3, warmup=100, steps=32, batch=128, target_entropy=0.5, alpha=0.3)
    probe = Probe(("hole",), 1, lambda scene, _, a, __: 300.0 * (a == 1))
    config = dataclasses.replace(flyer("sac"), learner=learner, updates=40)
    state = learned(config, probe)
    seen = jnp.asarray(observations(config, probe)[0])
    choices = sac._choices(config, state.learned.params["policy"], jax.random.key(0), seen)
    np.testing.assert_allclose(-(choices.weight * choices.log_prob).sum(), 0.5, atol=0.1)


def test_noise_and_epsilon_fall() -> None:
    rounds = jnp.array([0, 20, 40, 400])
    noise = [float(ddpg.noise(planner("ddpg"), made)) for made in rounds]
    np.testing.assert_allclose(noise, [0.3, 0.16, 0.02, 0.02], rtol=1e-5)
    share = [float(dqn.epsilon(flyer("dqn"), made)) for made in rounds]
    np.testing.assert_allclose(share, [1.0, 0.02, 0.02, 0.02], rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo slots", "dqn on the fly"])
def test_the_same_seed_gives_the_same_bits_and_seeds_go_side_by_side(name: str) -> None:
    """Two learners under `vmap` learn what each learns alone."""
    config = flyer(name.split()[0]) if name.endswith("fly") else planner(name)
    games, length = (("support",), 3) if name.endswith("fly") else (("support", "hole"), 1)  # programs of other tests
    probe = Probe(games, length, lambda scene, _, a, __: 100.0 * (a.reshape(len(a), -1)[:, 0] > 0.2))
    config = fitted(config, probe)
    learn = partial(algorithm(config).learn, config)
    states = [first_state(config, jax.random.key(seed)) for seed in (1, 2)]
    rounds = [play(config, state, jax.random.key(3), probe) for state in states]
    keys = jax.random.split(jax.random.key(4))
    alone = [learn(state, key, each, 2)[0] for state, key, each in zip(states, keys, rounds, strict=True)]
    again = learn(states[0], keys[0], rounds[0], 2)[0]
    together = jax.vmap(lambda state, key, each: learn(state, key, each, 2)[0])(
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *states),
        keys,
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *rounds),
    )
    for one, same in zip(jax.tree.leaves(alone[0]), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, same)
    for both, *each in zip(jax.tree.leaves(together), *map(jax.tree.leaves, alone), strict=True):
        np.testing.assert_allclose(both, np.stack(each), atol=2e-4)


def test_every_preset_can_work() -> None:
    for name, table in PRESETS.items():
        for agent, strategy in table:
            config = preset(agent, strategy, name)
            config.check()
            assert (config.agent, config.strategy, config.preset) == (agent, strategy, name)
            assert type(config.learner).__name__.lower() == agent
        assert {(agent, strategy) for agent in ALGORITHMS for strategy in AGENTS[agent]} == set(table)
    assert preset() == TrainConfig()
