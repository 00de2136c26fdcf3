"""dm_env: its own test of an environment, and a loop over its time steps that learns by the cross-entropy method."""

from __future__ import annotations

import pickle
import unittest
from collections.abc import Iterator

import dm_env
import numpy as np
from absl.testing import absltest
from dm_env import specs, test_utils
from score import Score, leave, now, record

from iphyre_jax.adapters import DmEnv

FLY, PLANS = "on-the-fly/support-v1", "in-advance/hole-v1"
GENERATIONS, PLANS_OF_ONE, BEST = 8, 40, 8
EPISODES = 60


class OnTheFly(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """Decisions every 0.1 s, past the end of an episode."""

    def make_object_under_test(self) -> dm_env.Environment:
        return DmEnv(FLY, seed=0)

    def make_action_sequence(self) -> Iterator[int]:
        yield from [0] * 155


class Copies(absltest.TestCase):
    """A copy goes on in the middle of an episode; float64, whose words JAX would cut in half where x64 is off."""

    def test_a_pickled_copy_goes_on(self) -> None:
        env = DmEnv(FLY, seed=0, dtype="float64")
        env.reset()
        env.step(1)
        twin = pickle.loads(pickle.dumps(env))  # noqa: S301
        for _ in range(3):
            ours, theirs = env.step(2), twin.step(2)
            np.testing.assert_array_equal(ours.observation, theirs.observation)
            assert ours.reward == theirs.reward


class InAdvance(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """Episodes of one decision."""

    def make_object_under_test(self) -> dm_env.Environment:
        return DmEnv(PLANS, seed=0)


def episode(env: dm_env.Environment, action: np.ndarray) -> float:
    """Play one episode of one decision."""
    assert env.reset().first()
    moment = env.step(action)
    assert moment.last()
    assert moment.observation.flags.writeable
    assert moment.discount == 0
    return float(moment.reward)


def main() -> bool:
    """Learn plans, play the last distribution and random plans, write the record."""
    start = now()
    rng, env = np.random.default_rng(0), DmEnv(PLANS, seed=0)
    spec = env.action_spec()
    assert isinstance(spec, specs.BoundedArray)

    def near(mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
        return np.clip(rng.normal(mean, deviation), spec.minimum, spec.maximum).astype(spec.dtype)

    mean, deviation = np.full(spec.shape, 0.25), np.full(spec.shape, 0.25)
    for _ in range(GENERATIONS):
        actions = [near(mean, deviation) for _ in range(PLANS_OF_ONE)]
        order = np.argsort([-episode(env, action) for action in actions])[:BEST]
        chosen = np.stack([actions[k] for k in order])
        mean, deviation = chosen.mean(0), chosen.std(0) + 0.005
    score = Score.of([episode(env, near(mean, deviation)) for _ in range(EPISODES)])
    uniform = [rng.uniform(spec.minimum, spec.maximum, spec.shape).astype(spec.dtype) for _ in range(EPISODES)]
    random = Score.of([episode(env, action) for action in uniform])
    ran = f"cross-entropy method, {GENERATIONS * PLANS_OF_ONE} episodes, {PLANS}"
    return record("dm-env-cem", "dm-env", ran, since=start, score=score, random=random)


if __name__ == "__main__":
    start = now()
    tests = unittest.TestSuite(map(unittest.defaultTestLoader.loadTestsFromTestCase, (OnTheFly, InAdvance, Copies)))
    passed = unittest.TextTestRunner().run(tests).wasSuccessful()
    if passed:
        record("dm-env-1", "dm-env", "its EnvironmentTestMixin, two strategies", since=start)
    leave(main() and passed)
