"""The examples run. Those that train for minutes or need other libraries run in `make test-clients`."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import load_scene, make, simulate
from iphyre_jax.scenes.compile import compile_scene, step_timing

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


@pytest.mark.slow
def test_the_loop_of_jax() -> None:
    _, params = make("on-the-fly/support-v1")
    with jax.numpy_rank_promotion("allow"):
        weights, rewards = jax.jit(example("reinforce_loop")["make_train"]("support", updates=3))(
            jax.random.key(0), params
        )
    assert rewards.shape == (3,)
    assert np.isfinite(rewards).all()
    assert np.isfinite(weights["out"]).all()
    assert np.abs(weights["out"]).max() > 0


@pytest.mark.slow
def test_seeds_under_vmap_are_the_runs_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    _, params = make("on-the-fly/support-v1")
    with jax.numpy_rank_promotion("allow"):
        rewards = example("seeds_under_vmap")["sweep"]("support", seeds=2, updates=2)
        alone = jax.jit(example("reinforce_loop")["make_train"]("support", updates=2))(jax.random.key(1), params)[1]
    assert rewards.shape == (2, 2)
    np.testing.assert_allclose(rewards[1], alone, rtol=1e-5)
    assert not np.array_equal(rewards[0], rewards[1])


def test_equal_instants_are_taken_apart() -> None:
    actions = example("ppo_forty_games")["actions_of"](jnp.array([[3, 3, 0, 4, 0, 3]]))
    np.testing.assert_allclose(actions * 150, [[3, 4, 0, 5, 0, 6]], rtol=1e-6)


def test_the_loop_of_gymnasium() -> None:
    reward, solved = example("gymnasium_loop")["random_plans"]("iphyre/in-advance-hole-v1", worlds=8, rounds=2)
    assert -100 < reward < 1000
    assert 0 <= solved <= 1


def test_poses_are_those_of_simulate() -> None:
    scene, plan = load_scene("support"), np.array([18, 6], np.int32)
    topology, world = compile_scene(scene, dtype="float32")
    film, success = example("poses_in_jit")["poses"](topology, world, step_timing(10, "float32"), plan, 150)
    played = simulate(scene, plan[None], fps=10, sample_every=1)
    assert played.samples is not None
    steps = int(played.steps[0])
    assert bool(success) == bool(played.success[0])
    movers = [k for k, moves in enumerate(scene.dynamic) if moves]
    np.testing.assert_allclose(film[: steps - 1], played.samples[0, 1:steps][:, movers], atol=0.01)


def test_the_scene_can_be_solved_but_not_by_anything() -> None:
    names = example("custom_scene")
    scene = names["ramp_with_a_stop"]()
    share, best = names["solving_share"](scene, plans=100)
    assert 0 < share < 1
    assert best > 900
    assert names["as_environment"](scene) == (16, 120)


def test_a_derivative_leads_to_the_wanted_place() -> None:
    names = example("gradients")
    end = names["make_end"](names["ramp"]())
    away = names["fit"](end, start=200.0, wanted=300.0)
    assert abs(away[0]) > 50
    assert abs(away[-1]) < 0.1
