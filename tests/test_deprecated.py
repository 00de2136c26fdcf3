"""Old names work for one version, and warn."""

import importlib
import re

import pytest

import iphyre_jax
from iphyre_jax.envs import in_advance

MOVED = [
    ("iphyre_jax.env", "play", iphyre_jax.play_plans),
    ("iphyre_jax.env", "observation_table", iphyre_jax.observation_table),
    ("iphyre_jax.env", "action_to_times", in_advance.action_to_times),
    ("iphyre_jax.env", "Episodes", in_advance.PlanResults),
    ("iphyre_jax.scenes.build", "build", iphyre_jax.compile_scene),
    ("iphyre_jax.scenes.build", "timing", iphyre_jax.step_timing),
]


@pytest.mark.parametrize(("module", "name", "new"), MOVED, ids=[f"{module}.{name}" for module, name, _ in MOVED])
def test_a_moved_name_warns_and_gives_the_new_one(module: str, name: str, new: object) -> None:
    old = importlib.import_module(module)
    with pytest.warns(DeprecationWarning, match=f"^{re.escape(module)}.{name}: use iphyre_jax") as caught:
        assert getattr(old, name) is new
    assert caught[0].filename == __file__


def test_an_unknown_old_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'iphyre_jax.env' has no attribute 'nothing'$"):
        importlib.import_module("iphyre_jax.env").nothing  # noqa: B018


def test_environment_alone_warns() -> None:
    env, params = iphyre_jax.make("in-advance/support-v1")
    with pytest.warns(DeprecationWarning, match=r"^Environment\.alone: use Environment\.single_game$"):
        assert env.alone(params, 0)[0] == env


def test_the_number_of_games_has_a_name_of_its_own() -> None:
    env, params = iphyre_jax.make("in-advance/support-v1")
    with pytest.warns(DeprecationWarning, match=r"^EnvParams\.games: use EnvParams\.n_games$"):
        assert params.games == params.n_games == len(env.games) == 1
