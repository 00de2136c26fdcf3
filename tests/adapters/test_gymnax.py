"""The adapters of gymnax's trainers, without gymnax; with it, see tests/clients."""

from __future__ import annotations

import sys
import types
from typing import Any

import jax
import pytest

import iphyre_jax
import iphyre_jax.adapters as adapters
from iphyre_jax import make
from iphyre_jax.adapters import FiveValues, GymnaxEnv, register_gymnax
from iphyre_jax.adapters.gymnax_env import GymnaxParams, GymnaxView


class _Discrete:
    def __init__(self, n: int) -> None:
        self.n = n


class _Box:
    def sample(self, key: Any) -> Any:
        return jax.numpy.full(self.shape, jax.numpy.nan)

    def __init__(self, low: float, high: float, shape: tuple[int, ...], dtype: Any) -> None:
        self.low, self.high, self.shape, self.dtype = low, high, shape, dtype


@pytest.fixture
def gymnax(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Gymnax's classes of spaces, which trainers ask for by `isinstance`, and its registry."""
    registered: dict[str, Any] = {}
    spaces = types.SimpleNamespace(Discrete=_Discrete, Box=_Box)
    registry = types.SimpleNamespace(registered_envs=registered, register=registered.__setitem__)
    for name, module in (
        ("", None),
        (".environments", None),
        (".environments.spaces", spaces),
        (".registration", registry),
    ):
        monkeypatch.setitem(sys.modules, f"gymnax{name}", module or types.ModuleType(f"gymnax{name}"))
    return registered


@pytest.mark.parametrize("adapter", [FiveValues, GymnaxEnv])
def test_spaces_are_those_of_gymnax_where_it_is(adapter: Any, gymnax: dict[str, Any]) -> None:
    env = adapter(*make("on-the-fly/support-v1"))
    assert isinstance(env.action_space(env.default_params), _Discrete)
    assert env.action_space().n == 7
    space = env.observation_space(env.default_params)
    assert isinstance(space, _Box)
    assert (space.low, space.high, space.shape, str(space.dtype)) == (0.0, 1.0, (122,), "float32")
    assert adapter(*make("in-advance/support-v1")).action_space().shape == (6,)


@pytest.mark.usefixtures("gymnax")
def test_samples_between_infinite_bounds_are_numbers() -> None:
    space = GymnaxEnv(*make("on-the-fly/support-v1", observation="motion")).observation_space()
    assert isinstance(space, _Box)
    sample = space.sample(jax.random.key(0))
    assert sample.shape == space.shape
    assert jax.numpy.isfinite(sample).all()


def test_the_packages_own_calls_ask_for_its_parameters() -> None:
    own, params = make("on-the-fly/support-v1")
    theirs = FiveValues(own, params).default_params
    assert isinstance(theirs, GymnaxParams)
    line = r"^params: expected the parameters that make has returned, got gymnax's; use params\.params$"
    with pytest.raises(ValueError, match=line):
        own.reset(jax.random.key(0), theirs)
    with pytest.raises(ValueError, match=line):
        iphyre_jax.envs.Batch.of(own, theirs, [0])
    own.reset(jax.random.key(0), theirs.params)


def test_parameters_are_replaced_as_those_of_gymnax() -> None:
    env = GymnaxEnv(*make("on-the-fly/support-v1"))
    assert isinstance(env.default_params, GymnaxParams)
    shorter = env.default_params.replace(max_steps_in_episode=5)
    assert (shorter.max_steps_in_episode, shorter.params) == (5, env.default_params.params)
    env.reset(jax.random.key(0), shorter)


@pytest.mark.parametrize(("strategy", "decisions"), [("in-advance", 1), ("on-the-fly", 150), ("combined", 7)])
def test_parameters_tell_the_length_of_an_episode(strategy: str, decisions: int) -> None:
    own, params = make(f"{strategy}/support-v1")
    env = FiveValues(own, params)
    assert env.default_params.max_steps_in_episode == decisions
    assert env.default_params.n_games == params.n_games == 1
    assert FiveValues(own, env.default_params).default_params.max_steps_in_episode == decisions
    traced = jax.jit(lambda given: given.max_steps_in_episode)(env.default_params)  # trainers pass them into programs
    assert int(traced) == decisions


def test_steps_have_five_and_six_values() -> None:
    five = FiveValues(*make("on-the-fly/support-v1"))
    six = GymnaxEnv(*make("on-the-fly/support-v1", final_observation=True))
    for env, count in ((five, 5), (six, 6)):
        obs, state = jax.eval_shape(env.reset, jax.random.key(0), env.default_params)
        out = jax.eval_shape(env.step, jax.random.key(0), state, jax.numpy.int32(0), env.default_params)
        assert len(out) == count
        assert {"terminated", "truncated", "success"} <= set(out[-1])
        assert ("final_observation" in out[-1]) == (count == 6)  # five hundred bytes of every kept decision
        assert out[0].shape == obs.shape


@pytest.mark.parametrize("adapter", [FiveValues, GymnaxEnv])
def test_a_plan_that_fails_ends_by_itself(adapter: type[GymnaxView]) -> None:
    env = adapter(*make("in-advance/support-v1"))
    _, state = env.reset(jax.random.key(0))
    *_, info = env.step(jax.random.key(0), state, jax.numpy.zeros(6))
    assert (bool(info["success"]), bool(info["terminated"]), bool(info["truncated"])) == (False, True, False)


def test_every_id_is_registered_in_both_forms(gymnax: dict[str, Any]) -> None:
    names = register_gymnax()
    assert set(names) == set(gymnax) == set(register_gymnax())
    six = gymnax["iphyre/in-advance-hole-v1"](observation="motion")
    assert isinstance(six, GymnaxEnv)
    assert six.env.final_observation
    assert six.env.observation == "motion"
    five = gymnax["iphyre-five/in-advance-hole-v1"]()
    assert isinstance(five, FiveValues)
    assert not five.env.final_observation


def test_a_missing_gymnax_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnax", None)
    monkeypatch.delitem(sys.modules, "gymnax.registration", raising=False)
    with pytest.raises(ImportError, match=r"^register_gymnax needs the extra 'gymnax'") as caught:
        adapters.register_gymnax()
    assert "\n" not in str(caught.value)
