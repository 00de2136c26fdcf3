"""Every algorithm on probes with known answers, its pieces against hand-worked numbers."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.train.algos import ppo
from iphyre_jax.train.algos.actor_critic import Batch
from iphyre_jax.train.algos.ddpg import DDPGAlgorithm
from iphyre_jax.train.algos.dqn import DQNAlgorithm
from iphyre_jax.train.algos.ppo import PPOAlgorithm
from iphyre_jax.train.algos.registry import ALGORITHMS, algorithm
from iphyre_jax.train.algos.replay import Transition
from iphyre_jax.train.algos.sac import SACAlgorithm
from iphyre_jax.train.settings.agents import A2C, DDPG, DQN, PPO, SAC, Settings
from iphyre_jax.train.settings.presets import AGENTS, PresetName
from iphyre_jax.train.settings.run import TrainConfig, preset
from tests.cases import further_but
from tests.train.algos.probes import Probe, first_state, fitted, greedy_actions, learned, observations, play

PLANNING: dict[str, tuple[Settings, dict[str, Any]]] = {
    "ppo time_grid": (PPO(learning_rate=3e-3), {"head": "time_grid"}),
    "ppo gaussian": (PPO(learning_rate=3e-3), {"head": "gaussian"}),
    "a2c time_grid": (A2C(learning_rate=3e-3, minibatches=8), {"head": "time_grid"}),
    "sac": (SAC(learning_rate=3e-3, warmup=100, gradient_steps=32, batch_size=128), {"head": "tanh_normal"}),
    "ddpg": (
        DDPG(learning_rate=3e-3, warmup=100, gradient_steps=32, batch_size=128, noise_updates=40),
        {"head": "deterministic"},
    ),
}
CRITIC: dict[str, Any] = {"critic": True, "samples_per_update": 256, "learning_rate": 3e-3, "gae_lambda": 0.9}
FLYING: dict[str, Settings] = {
    "ppo": PPO(**CRITIC),
    "a2c": A2C(**CRITIC, minibatches=8),
    "sac": SAC(
        learning_rate=3e-3, warmup=100, gradient_steps=32, batch_size=128, target_entropy=0.2, alpha=0.01, tau=0.05
    ),
    "dqn": DQN(
        learning_rate=3e-3, warmup=100, gradient_steps=32, batch_size=128, epsilon_updates=20, no_op_prob=0.5, tau=0.05
    ),
}


def ppo_of(config: TrainConfig) -> PPOAlgorithm:
    assert isinstance(config.learner, PPO)
    return PPOAlgorithm(config, config.learner)


def sac_of(config: TrainConfig) -> SACAlgorithm:
    assert isinstance(config.learner, SAC)
    return SACAlgorithm(config, config.learner)


def ddpg_of(config: TrainConfig) -> DDPGAlgorithm:
    assert isinstance(config.learner, DDPG)
    return DDPGAlgorithm(config, config.learner)


def dqn_of(config: TrainConfig) -> DQNAlgorithm:
    assert isinstance(config.learner, DQN)
    return DQNAlgorithm(config, config.learner)


def planner(name: str, **settings: Any) -> TrainConfig:
    learner, given = PLANNING[name]
    agent: Any = name.split()[0]
    return TrainConfig(
        agent=agent, learner=learner, hidden_sizes=(32,), updates=40, episodes_per_scene=64, **given | settings
    )


def flyer(name: str, **settings: Any) -> TrainConfig:
    agent: Any = name
    given = {"head": "uniform", "hidden_sizes": (32,), "updates": 40, "episodes_per_scene": 64}
    return TrainConfig(
        agent=agent, strategy="on-the-fly", observation="motion", learner=FLYING[name], **given | settings
    )


GOALS = np.array([4.0, 11.0])  # s


def early_or_late(scene: np.ndarray, k: int, action: np.ndarray, good: np.ndarray) -> np.ndarray:
    """One decision; scene 0 pays for block 0 at 4 s, scene 1 at 11 s, the less the farther off."""
    return 1000.0 * np.exp(-np.square((15 * action[:, 0] - GOALS[scene]) / 2.5))


@pytest.mark.slow
@pytest.mark.parametrize("name", further_but(PLANNING, "ppo time_grid", "ddpg"))
def test_what_is_seen_decides_when(name: str) -> None:
    probe = Probe(("support", "spring"), 1, early_or_late)
    config = planner(name)
    np.testing.assert_allclose(greedy_actions(config, probe, learned(config, probe))[0, :, 0], GOALS, atol=1.5)


def right_so_far(k: int, action: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Nothing at the first decision, block 0 at the second, anything at the third; it is seen whether all was right."""
    return good & ((action == k) | (k == 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", further_but(FLYING, "a2c"))
def test_what_pays_later_is_learned(name: str) -> None:
    """Needs values that look ahead: a reward two decisions later is due to this one."""
    probe = Probe(("support",), 3, lambda scene, k, _, good: 1000.0 * (good & (k == 2)), right_so_far)
    config = flyer(name)
    np.testing.assert_array_equal(greedy_actions(config, probe, learned(config, probe))[:2, 0], [0, 1])


@pytest.mark.slow
def test_never_pays() -> None:
    """Every removal costs 10 and nothing succeeds: the best plan removes nothing."""
    probe = Probe(("seesaw",), 1, lambda _, __, a, ___: -15 - 10.0 * (a[:, :2] > 0).sum(axis=1))
    config = planner("ppo time_grid")
    np.testing.assert_array_equal(greedy_actions(config, probe, learned(config, probe))[0, 0, :2], [0, 0])


@pytest.mark.slow
def test_small_differences_count_within_a_scene() -> None:
    """One scene pays 1000, the other never does: a difference of 10 in the first is still learned."""
    probe = Probe(
        ("support", "seesaw"), 1, lambda scene, _, a, __: np.where(scene == 0, 1000.0 - 10 * (a[:, 1] > 0), -15.0)
    )
    config = planner("ppo time_grid")
    assert greedy_actions(config, probe, learned(config, probe))[0, 0, 1] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("agent", "gamma"), [("ppo", 0.5), ("dqn", 0.5)])
def test_values_are_discounted_sums(agent: str, gamma: float) -> None:
    """400 points in each of three decisions, whatever is done: 0.4 (1 + d + d^2), 0.4 (1 + d), 0.4."""
    probe = Probe(("support",), 3, lambda scene, *_: np.full(len(scene), 400.0))
    config = flyer(agent)
    config = dataclasses.replace(config, learner=dataclasses.replace(config.learner, gamma=gamma))
    state, obs = learned(config, probe), jnp.asarray(observations(config, probe)[:3, 0])
    if agent == "dqn":
        found = dqn_of(config).values(state.train_state.value, obs)[:, :3].max(axis=-1)
    else:
        found = ppo_of(config).value(state.params, obs)
    np.testing.assert_allclose(found, [0.7, 0.6, 0.4], atol=0.06)


def test_clipped_objective_by_hand() -> None:
    """The better ratio is only rewarded up to 1.2, the worse one only spared down to 0.8."""
    ratio = jnp.array([1.5, 1.5, 0.5, 0.5, 1.1])
    advantage = jnp.array([2.0, -2.0, 2.0, -2.0, 3.0])
    np.testing.assert_allclose(ppo.clipped_objective(ratio, advantage, 0.2), [2.4, -3.0, 1.0, -1.6, 3.3], rtol=1e-6)


def batch_for(config: TrainConfig, state: Any, advantage: list[float]) -> tuple[jax.Array, Batch]:
    obs = jnp.asarray(observations(config, Probe(("support", "hole"), 1, early_or_late))[0])
    row = jnp.array([0, 0, 1, 1])
    output = algorithm(config).sample_action(state, jax.random.key(5), obs[row])
    gain, there = jnp.asarray(advantage), jnp.array([1.0, 1.0, 1.0, 0.0])
    return obs, Batch(row, output.raw_action, output.log_prob, gain, gain, there)


@pytest.mark.slow
def test_ppo_loss_before_the_first_step() -> None:
    """All ratios are 1: minus the mean advantage of what was there, minus the weighted entropy; nothing is clipped."""
    config = planner("ppo time_grid")
    state = first_state(config, jax.random.key(0))
    obs, batch = batch_for(config, state, [1.0, -0.5, 2.0, 100.0])
    zero = jnp.zeros(())
    value, metrics = ppo_of(config).loss(state.params, obs, batch, zero, zero)
    np.testing.assert_allclose(value, -2.5 / 3, rtol=1e-5)
    np.testing.assert_allclose([metrics["kl"], metrics["clipped"]], [0.0, 0.0], atol=1e-6)
    with_bonus, _ = ppo_of(config).loss(state.params, obs, batch, jnp.float32(0.5), zero)
    np.testing.assert_allclose(with_bonus, -2.5 / 3 - 0.5 * float(metrics["entropy"]), rtol=1e-5)


def test_ppo_loss_of_another_policy_by_hand() -> None:
    """Plans that were half as probable when they were sampled: ratio 2, beyond the clip range."""
    config = planner("ppo time_grid")
    state = first_state(config, jax.random.key(0))
    obs, batch = batch_for(config, state, [1.0, 1.0, -1.0, 7.0])
    batch = batch._replace(log_prob=batch.log_prob - math.log(2))
    value, metrics = ppo_of(config).loss(state.params, obs, batch, jnp.zeros(()), jnp.float32(0.1))
    kl = 2 - 1 - math.log(2)
    np.testing.assert_allclose(value, -(1.2 + 1.2 - 2.0) / 3 + 0.1 * kl, rtol=1e-4)
    np.testing.assert_allclose([metrics["kl"], metrics["clipped"]], [kl, 1.0], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("network", further_but(("mlp", "objects"), "mlp"))
def test_an_observation_of_many_decisions_is_seen_once(network: Any) -> None:
    """Loss and gradient are those of the same observation given anew for each decision."""
    config = planner("ppo time_grid", network=network)
    state = first_state(config, jax.random.key(0))
    obs, batch = batch_for(config, state, [1.0, -0.5, 2.0, 100.0])
    one_each = batch._replace(row=jnp.arange(4))
    differentiated = jax.jit(jax.value_and_grad(ppo_of(config).loss, has_aux=True))
    few = differentiated(state.params, obs, batch, jnp.float32(0.5), jnp.zeros(()))
    many = differentiated(state.params, obs[batch.row], one_each, jnp.float32(0.5), jnp.zeros(()))
    for one, other in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


def test_minibatches_of_scenes_hold_every_decision_once_with_its_own_observation() -> None:
    """Six scenes of three plans in two minibatches; the loss is that of the same decisions with all observations."""
    learner = PPO(minibatches=2, minibatch_of="scenes")
    config = dataclasses.replace(planner("ppo time_grid"), learner=learner)
    agent, state = ppo_of(config), first_state(config, jax.random.key(0))
    obs = jnp.asarray(observations(config, Probe(("support", "hole", "spring"), 1, early_or_late))[0])
    obs, row = jnp.concatenate([obs, 0.5 * obs]), jnp.repeat(jnp.arange(6, dtype=jnp.int32), 3)
    output = agent.sample_action(state, jax.random.key(1), obs, 3)
    batch = Batch(row, output.raw_action, output.log_prob, jnp.arange(18.0), jnp.zeros(18), jnp.ones(18))
    both = agent.minibatches(batch, jax.random.key(2), 6)
    assert sorted(both.obs_rows.flatten().tolist()) == list(range(6))
    assert sorted(both.decisions.advantage.flatten().tolist()) == list(range(18))
    for k in range(2):
        scenes, decisions = both.obs_rows[k], jax.tree.map(lambda leaf, k=k: leaf[k], both.decisions)
        which = decisions.advantage.astype(int)
        np.testing.assert_array_equal(scenes[decisions.row], row[which])
        np.testing.assert_array_equal(decisions.raw_action, output.raw_action[which])
        few, _ = agent.loss(state.params, obs[scenes], decisions, jnp.float32(0.5), jnp.zeros(()))
        whole = decisions._replace(row=row[which])
        many, _ = agent.loss(state.params, obs, whole, jnp.float32(0.0), jnp.zeros(()))
        alone, _ = agent.loss(state.params, obs[scenes], decisions, jnp.float32(0.0), jnp.zeros(()))
        np.testing.assert_allclose(alone, many, rtol=1e-5)
        assert float(few) != float(alone)  # the entropy counts too


def test_the_weight_of_the_divergence_adapts() -> None:
    agent = PPOAlgorithm(TrainConfig(), PPO(kl_coef=0.2, kl_target=0.01))
    far, near, right = (float(agent.adapted(jnp.float32(0.2), jnp.float32(kl))) for kl in (0.03, 0.004, 0.01))
    np.testing.assert_allclose([far, near, right], [0.3, 0.1, 0.2], rtol=1e-6)


def transition_of(config: TrainConfig, raw_action: jax.Array, discount: float) -> Transition:
    obs = jnp.asarray(observations(config, Probe(("support",), 1, early_or_late))[0])
    return Transition(obs, raw_action, jnp.array([0.5]), jnp.array([discount]), obs)


@pytest.mark.slow
def test_dqn_target_by_hand() -> None:
    """Chosen by the learned network, valued by the target's: 0.5 + 0.9 Q'(argmax Q)."""
    config = flyer("dqn", head="categorical")
    agent, learner = dqn_of(config), first_state(config, jax.random.key(0)).train_state
    learner = learner._replace(target=first_state(config, jax.random.key(1)).train_state.value)
    batch = transition_of(config, jnp.array([0]), 0.9)
    chosen = int(agent.values(learner.value, batch.next_obs).argmax())
    value = agent.values(learner.target, batch.next_obs)[0, chosen]
    np.testing.assert_allclose(agent.targets(learner, batch), [0.5 + 0.9 * float(value)], rtol=1e-5)
    assert chosen <= 2  # support has two blocks; this head offers no other slots
    assert float(agent.targets(learner, batch._replace(discount=jnp.zeros(1)))[0]) == 0.5


@pytest.mark.slow
def test_discrete_sac_target_by_hand() -> None:
    """0.5 + 0.9 sum_a pi(a) (min Q'(a) - alpha log pi(a)) over the three actions that support has."""
    config = flyer("sac", head="categorical")
    agent, learner = sac_of(config), first_state(config, jax.random.key(0)).train_state
    batch = transition_of(config, jnp.array([0]), 0.9)
    share = np.array([0.97, 0.015, 0.015])  # the head's prior: the policy's last layer is next to nothing at the start
    values = np.asarray(agent.values(learner.target, batch.next_obs, batch.raw_action)).min(axis=0)[0, :3]
    soft = (share * (values - 0.01 * np.log(share))).sum()
    np.testing.assert_allclose(agent.targets(learner, jax.random.key(3), batch), [0.5 + 0.9 * soft], atol=2e-3)


@pytest.mark.slow
@pytest.mark.further
def test_sac_holds_its_entropy() -> None:
    """Block 0 pays 300 points; alpha brings the entropy of the policy to the target, and no lower."""
    learner = SAC(learning_rate=3e-3, warmup=100, gradient_steps=32, batch_size=128, target_entropy=0.5, alpha=0.3)
    probe = Probe(("hole",), 1, lambda scene, _, a, __: 300.0 * (a == 1))
    config = dataclasses.replace(flyer("sac"), learner=learner, updates=40)
    state = learned(config, probe)
    obs = jnp.asarray(observations(config, probe)[0])
    candidates = sac_of(config).candidates(state.train_state.params["policy"], jax.random.key(0), obs)
    np.testing.assert_allclose(-(candidates.weight * candidates.log_prob).sum(), 0.5, atol=0.1)


def test_noise_and_epsilon_fall() -> None:
    updates = jnp.array([0, 20, 40, 400])
    noise = [float(ddpg_of(planner("ddpg")).noise(made)) for made in updates]
    np.testing.assert_allclose(noise, [0.3, 0.16, 0.02, 0.02], rtol=1e-5)
    share = [float(dqn_of(flyer("dqn")).epsilon(made)) for made in updates]
    np.testing.assert_allclose(share, [1.0, 0.02, 0.02, 0.02], rtol=1e-5)


def test_seeds_share_compiled_programs() -> None:
    config = planner("ppo time_grid")
    assert algorithm(config) == algorithm(dataclasses.replace(config, seed=config.seed + 1))
    assert algorithm(config) != algorithm(dataclasses.replace(config, fps=config.fps + 10))


@pytest.mark.slow
@pytest.mark.parametrize("name", further_but(("ppo time_grid", "dqn on the fly"), "ppo time_grid"))
def test_the_same_seed_gives_the_same_bits_and_seeds_go_side_by_side(name: str) -> None:
    """Two learners under `vmap` learn what each learns alone."""
    config = flyer(name.split()[0]) if name.endswith("fly") else planner(name)
    games, length = (("support",), 3) if name.endswith("fly") else (("support", "hole"), 1)  # programs of other tests
    probe = Probe(games, length, lambda scene, _, a, __: 100.0 * (a.reshape(len(a), -1)[:, 0] > 0.2))
    config = fitted(config, probe)
    learn = algorithm(config).learn
    states = [first_state(config, jax.random.key(seed)) for seed in (1, 2)]
    trajectories = [play(config, state, jax.random.key(3), probe) for state in states]
    keys = jax.random.split(jax.random.key(4))
    alone = [learn(state, key, each, 2)[0] for state, key, each in zip(states, keys, trajectories, strict=True)]
    again = learn(states[0], keys[0], trajectories[0], 2)[0]
    together = jax.vmap(lambda state, key, each: learn(state, key, each, 2)[0])(
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *states),
        keys,
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *trajectories),
    )
    for one, same in zip(jax.tree.leaves(alone[0]), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, same)
    for both, *each in zip(jax.tree.leaves(together), *map(jax.tree.leaves, alone), strict=True):
        np.testing.assert_allclose(both, np.stack(each), atol=2e-4)


def test_every_preset_can_work() -> None:
    assert set(ALGORITHMS) == set(AGENTS)
    for agent, spec in AGENTS.items():
        assert set(spec.default) == set(spec.paper) == set(spec.strategies)
        for strategy in spec.strategies:
            for name in get_args(PresetName):
                config = preset(agent, strategy, name)
                config.check()
                assert (config.agent, config.strategy, config.preset) == (agent, strategy, name)
                assert type(config.learner).__name__.lower() == agent
    assert preset(name="quick") == TrainConfig()
