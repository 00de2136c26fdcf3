"""The adapters of gymnasium: its own checks, and the vector environment against single ones."""

from __future__ import annotations

import importlib
import os
from typing import Any

import gymnasium
import numpy as np
import pytest

import iphyre_jax
import iphyre_jax.adapters as adapters
from iphyre_jax.adapters import GymnasiumEnv, GymnasiumVectorEnv

ALL = bool(os.environ.get("IPHYRE_JAX_CHECK_ALL"))
STRATEGIES, GAMES = ("in-advance", "on-the-fly", "combined"), ("support-v1", "coupled-v1")


def test_in_advance_ends_terminated_and_keeps_the_official_flags() -> None:
    env = GymnasiumEnv("in-advance/support-v1")
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.zeros(6, np.float32))
    assert (reward, terminated, truncated) == (-15.0, True, False)
    assert not info["official_terminated"]
    assert info["official_truncated"]
    assert info["time"] == 15.0


def test_observations_are_the_users_own() -> None:
    env = GymnasiumEnv("on-the-fly/support-v1", render_mode="rgb_array")
    obs, _ = env.reset(seed=0)
    for array in (obs, env.step(0)[0], env.render()):
        assert array is not None
        array[:] = 0
    assert env.step(0)[0].any()


def _random_actions(rng: np.random.Generator, strategy: str, count: int) -> np.ndarray:
    """Removals that solve some games and leave others."""
    return rng.integers(0, 3, count) if strategy == "on-the-fly" else rng.uniform(0, 1, (count, 6)).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "games"),
    [(strategy, games) for strategy in STRATEGIES for games in GAMES] if ALL else [("on-the-fly", "support-v1")],
)
def test_the_vector_environment_is_its_single_ones(strategy: str, games: str) -> None:
    if games not in {name.partition("/")[2] for name in iphyre_jax.environment_ids()}:
        iphyre_jax.register(games, ["support", "multi_ball_hole"])  # of different topologies
    adapters.register_gymnasium()
    count, rng = 4, np.random.default_rng(0)
    vector = gymnasium.make_vec(f"iphyre/{strategy}-{games}", num_envs=count)
    assert vector.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.SAME_STEP
    singles = [GymnasiumEnv(f"{strategy}/{games}") for _ in range(count)]
    obs, infos = vector.reset(seed=5)
    own = [env.reset(seed=5 + k) for k, env in enumerate(singles)]
    np.testing.assert_array_equal(obs, [one[0] for one in own])
    ended = 0
    for _ in range(160 if ALL else 60):
        actions = _random_actions(rng, strategy, count)
        obs, rewards, terminated, truncated, infos = vector.step(actions)
        for k, env in enumerate(singles):
            one = env.step(actions[k])
            np.testing.assert_allclose(rewards[k], one[1], rtol=1e-6)
            assert (terminated[k], truncated[k]) == one[2:4]
            if one[2] or one[3]:
                ended += 1
                np.testing.assert_allclose(infos["final_obs"][k], one[0], atol=1e-6)
                assert infos["_final_obs"][k]
                for name, value in one[4].items():
                    np.testing.assert_allclose(infos["final_info"][name][k], value, rtol=1e-6)
                one = env.reset()
            np.testing.assert_allclose(obs[k], one[0], atol=1e-6)
    assert ended >= count


def test_seeds_and_games() -> None:
    iphyre_jax.register("seeds-v1", ["support", "hinder", "direction", "hole", "noisy_support", "noisy_hinder"])
    env = GymnasiumEnv("in-advance/seeds-v1")
    assert {env.reset(options={"game": game})[1]["game"] for game in (0, "hole", 5)} == {0, 3, 5}
    first = [env.reset(seed=3)[1]["game"], *(env.reset()[1]["game"] for _ in range(8))]
    again = [env.reset(seed=3)[1]["game"], *(env.reset()[1]["game"] for _ in range(8))]
    assert first == again
    assert len(set(first)) > 2


def _single(action: Any) -> Any:
    def call() -> None:
        env = GymnasiumEnv("on-the-fly/support-v1")
        env.reset(seed=0)
        env.step(action)

    return call


def _planned(action: Any) -> Any:
    def call() -> None:
        env = GymnasiumEnv("in-advance/support-v1")
        env.reset(seed=0)
        env.step(action)

    return call


def _vector(action: Any, **options: Any) -> Any:
    def call() -> None:
        env = GymnasiumVectorEnv("on-the-fly/support-v1", **({"num_envs": 2} | options))
        env.reset(seed=0)
        env.step(action)

    return call


BAD = {
    "seven": (_single(7), "action: expected numbers from 0 to 6, got 7"),
    "minus one": (_single(-1), "action: expected numbers from 0 to 6"),
    "half": (_single(0.5), "action: expected whole numbers, got dtype float64"),
    "list": (_single([1]), r"action: expected shape \(\), got \(1,\)"),
    "text": (_single("1"), "action: expected whole numbers"),
    "none": (_single(None), "action: expected whole numbers"),
    "five times": (_planned(np.zeros(5)), r"action: expected shape \(6,\), got \(5,\)"),
    "above one": (_planned(np.full(6, 1.5)), "action: expected numbers from 0 to 1"),
    "nan": (_planned(np.full(6, np.nan)), "action: expected numbers from 0 to 1, got one outside or NaN"),
    "ragged": (_planned([[1], [1, 2]]), "action: expected an array"),
    "words": (_planned(["a"] * 6), "action: expected numbers, got dtype"),
    "three of two": (_vector([0, 1, 2]), r"action: expected shape \(2,\), got \(3,\)"),
    "no worlds": (_vector([], num_envs=0), "num_envs: expected a whole number of at least 1"),
    "half a world": (_vector([], num_envs=0.5), "num_envs: expected a whole number of at least 1"),
    "autoreset": (_vector([], autoreset=False), "autoreset: expected none"),
    "final of one": (
        lambda: GymnasiumEnv("on-the-fly/support-v1", final_observation=True),
        "final_observation: expected none",
    ),
    "game in an array": (
        lambda: GymnasiumVectorEnv("on-the-fly/hole-v1").reset(options={"game": np.array(1)}),
        "options: expected a game",
    ),
    "final": (_vector([], final_observation=True), "final_observation: expected none"),
    "no reset": (lambda: GymnasiumEnv("on-the-fly/support-v1").step(0), "step: expected a call of reset"),
    "human": (lambda: GymnasiumEnv("on-the-fly/support-v1", render_mode="human"), "render_mode: expected"),
    "game": (lambda: GymnasiumEnv("on-the-fly/hole-v1").reset(options={"game": "spring"}), "options: expected a game"),
    "seeds": (lambda: GymnasiumVectorEnv("on-the-fly/hole-v1", 2).reset(seed=[1]), "seed: expected 2, one for each"),
    "option": (lambda: GymnasiumEnv("on-the-fly/hole-v1").reset(options={"a": 1}), "options: expected none but game"),
    "options": (lambda: GymnasiumVectorEnv("on-the-fly/hole-v1").reset(options={"a": 1}), "options: expected none"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_calls_get_one_line(case: str) -> None:
    call, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError("No module named 'brax'", name="brax")

    monkeypatch.setattr(adapters, "import_module", missing)
    with pytest.raises(
        ImportError, match=r"^BraxEnv needs the extra 'brax' \(brax is missing\): pip install 'iphyre-jax"
    ):
        _ = adapters.BraxEnv
    assert importlib.import_module is not missing
