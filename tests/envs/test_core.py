"""The environment's contract: trees, types, keys, mapping, autoreset, mixtures, faults and refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax import load_scene, make
from iphyre_jax.envs.batching.status import status_words
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.observations.official import scene_features, start_observation
from iphyre_jax.scenes.compile import compile_scene
from tests.trees import assert_equal_trees

BATCH = 8


@cache
def environment(games: str = "support", autoreset: bool = True) -> Any:
    return make(f"on-the-fly/{games}-v1", autoreset=autoreset, final_observation=True)


def keys(seed: int, count: int = BATCH) -> jax.Array:
    return jax.random.split(jax.random.key(seed), count)


@cache
def batched(env: Any) -> Any:
    """Reset, and ten steps with given actions, of a batch."""

    def play(key: jax.Array, actions: jax.Array, params: Any) -> Any:
        obs, state = env.reset(key, params)

        def one(state: Any, action: jax.Array) -> Any:
            out = env.step(key, state, action, params)
            return out[1], (out[0], *out[2:])

        return obs, *jax.lax.scan(one, state, actions)

    return jax.jit(jax.vmap(play, in_axes=(0, 0, None)))


@cache
def batched_step(env: Any) -> Any:
    return jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))


def actions(seed: int = 0, count: int = BATCH, steps: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 3, (count, steps)).astype(np.int32)


def test_trees_shapes_and_types_do_not_depend_on_x64() -> None:
    env, params = environment()
    forms = []
    for x64 in (False, True):
        with jax.enable_x64(x64):
            obs, state = jax.eval_shape(env.reset, jax.random.key(0), params)
            action = jax.eval_shape(env.action_space().sample, jax.random.key(0))
            out = jax.eval_shape(env.step, jax.random.key(0), state, action, params)
            info = jax.eval_shape(env.info, state, params)
        assert jax.tree.structure(info) == jax.tree.structure(out[5])
        assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), (out[0], out[1])) == jax.tree.map(
            lambda leaf: (leaf.shape, leaf.dtype), (obs, state)
        )
        forms.append(jax.tree.map(lambda leaf: (leaf.shape, str(leaf.dtype)), (obs, state, *out)))
        assert [str(part.dtype) for part in (obs, *out[2:5])] == ["float32", "float32", "bool", "bool"]
    assert forms[0] == forms[1]


def test_typed_and_old_keys_give_the_same() -> None:
    env, _ = environment()
    params = env.params(["support", "hinder", "direction", "hole", "noisy_support", "noisy_hinder"])
    games = [int(env.reset(key, params)[1].game) for key in (jax.random.key(3), jax.random.PRNGKey(3))]
    assert games[0] == games[1]
    drawn = {int(env.reset(key, params)[1].game) for key in keys(0, 40)}
    assert drawn == set(range(6))


def test_observations_at_the_start_are_the_official_ones() -> None:
    """Of games with balls, bars, a pin, a spring, and all of their layouts; `make parity-official` has all games."""
    some = {
        compile_scene(load_scene(game))[0] for game in ("hole", "seesaw", "pendulum", "spring", "multi_ball_hinder")
    }
    games = [game for game in iphyre_jax.GAMES if compile_scene(load_scene(game))[0] in some]
    assert len(games) > 20
    iphyre_jax.register("starts-v1", games)
    env, params = make("on-the-fly/starts-v1")
    obs = jax.vmap(lambda game: env.reset_to(game, params)[0])(jnp.arange(len(games)))
    assert obs.shape[1:] == env.observation_space().shape
    assert env.observation_space().contains(obs[0])
    np.testing.assert_array_equal(obs[:, 108:110], 0)  # the candidate that does nothing
    expected = np.stack([start_observation(load_scene(game)) for game in games])
    np.testing.assert_array_equal(np.delete(obs, [108, 109], axis=1), expected)


def test_motion_adds_velocities_and_time() -> None:
    official, params = environment()
    env = replace(official, observation="motion")
    obs, state = env.reset(jax.random.key(0), params)
    assert obs.shape == env.observation_space().shape == (122 + 37,)
    np.testing.assert_array_equal(obs[122:], 0)
    for frame in range(1, 6):
        state = official.step(jax.random.key(0), state, jnp.int32([1, 2, 0, 0, 0][frame - 1]), params)[1]
        obs = env.observe(state, params)
        np.testing.assert_allclose(obs[-1], frame / 150, rtol=1e-6)
    falling = obs[122:-1].reshape(12, 3)[2]
    assert falling[0] == falling[2] == 0
    assert 10 / 600 < falling[1] <= 50 / 600  # 0.5 s at 100 px/s^2, less the time on the bar
    np.testing.assert_array_equal(np.delete(obs[122:-1].reshape(12, 3), 2, axis=0), 0)


@pytest.mark.slow
def test_nested_maps_and_a_map_over_params() -> None:
    env, params = environment()
    flat = batched(env)(keys(0), actions(), params)
    nested = jax.vmap(batched(env), in_axes=(0, 0, None))(keys(0).reshape(2, 4), actions().reshape(2, 4, -1), params)
    assert_equal_trees(jax.tree.map(lambda leaf: leaf.reshape(BATCH, *leaf.shape[2:]), nested), flat)
    tables = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[env.params([game]) for game in ("support", "hole")])
    mapped = jax.vmap(env.reset, in_axes=(None, 0))(jax.random.key(0), tables)[0]
    for obs, game in zip(mapped, ("support", "hole"), strict=True):
        np.testing.assert_allclose(np.delete(obs, [108, 109]), start_observation(load_scene(game)), atol=1e-7)


def test_a_game_alone_is_as_if_nothing_else_had_been_made() -> None:
    """They share a topology, with a pin and a spring, which none has alone."""
    games = ("hole", "pendulum", "spring")
    iphyre_jax.register("three-v1", games)
    env, params = iphyre_jax.make("on-the-fly/three-v1")
    assert len(env.topologies) == 1
    for game in games:
        one, own = env.single_game(params, env.games.index(game))
        made, given = iphyre_jax.make(f"on-the-fly/{game}-v1")
        assert one == made != env
        assert one.games == (game,)
        assert_equal_trees(own, given)


def test_autoreset_goes_on_and_keeps_the_last_observation() -> None:
    env, params = environment()
    still, _ = environment(autoreset=False)
    plays = {}
    for one in (env, still):
        _, state = one.reset(jax.random.key(0), params)
        plays[one.autoreset] = []
        for action in [1, 2, *[0] * 40]:
            out = one.step(jax.random.key(1), state, jnp.int32(action), params)
            state = out[1]
            plays[one.autoreset].append(out)
    ends = [bool(out[3]) for out in plays[False]].index(True)
    auto, kept = plays[True][ends], plays[False][ends]
    np.testing.assert_array_equal(auto[5]["final_observation"], kept[0])
    np.testing.assert_array_equal(auto[0], env.reset(jax.random.key(1), params)[0])
    assert bool(auto[3])
    assert float(auto[2]) == float(kept[2]) > 900
    assert int(env.worlds.status(params, auto[1]).step) == 0
    assert_equal_trees(jax.tree.leaves(auto[5]), jax.tree.leaves(kept[5]))
    later = plays[False][-1]  # ended, it stays: no reward, the same flags and observation
    assert float(later[2]) == 0
    assert bool(later[3])
    assert_equal_trees(later[0], kept[0])
    assert_equal_trees(later[1], kept[1])


@pytest.mark.slow
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_unsound_world_stops_alone_and_is_clean_after_reset(bad: float) -> None:
    env, params = environment()
    step = batched_step(env)
    _, state = jax.vmap(env.reset, in_axes=(0, None))(keys(0), params)
    (topology,) = env.topologies
    layout, first = episode_layout(topology, "float32"), status_words(env.limits.blocks)
    places = layout.first_rows().state
    impulses = places.cache.normal_impulse + np.arange(topology.slots)
    wrong = first + np.array([places.motion.velocity.y, *impulses])
    sick = replace(state, words=state.words.at[3, wrong].set(np.float32(bad).view(np.int32)))
    others = np.arange(BATCH) != 3
    for t in range(10):
        clean_out = step(keys(t), state, actions()[:, t], params)
        sick_out = step(keys(t), sick, actions()[:, t], params)
        for one, other in zip(jax.tree.leaves(sick_out), jax.tree.leaves(clean_out), strict=True):
            np.testing.assert_array_equal(one[others], other[others])
        for leaf in jax.tree.leaves((sick_out[0], sick_out[2], sick_out[5])):
            assert np.isfinite(leaf).all()
        assert int(sick_out[5]["fault"][3]) == (2 if t == 0 else 0)
        assert bool(sick_out[4][3]) == (t == 0)
        state, sick = clean_out[1], sick_out[1]
    numbers = np.asarray(sick.words)[:, first + layout.whole_rows :].view(np.float32)
    assert not np.isnan(numbers).any()


def test_float64_asks_for_x64() -> None:
    env, params = make("in-advance/support-v1", dtype="float64")
    with pytest.raises(ValueError, match=r"^dtype: expected jax\.enable_x64"):
        env.reset(jax.random.key(0), params)


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no id": ({"id": None}, "id: expected one of"),
    "no version": ({"id": "in-advance/basic"}, "did you mean in-advance/basic-v1"),
    "strategy": ({"id": "in-advanced/basic-v1"}, "id: expected one of"),
    "protocol": ({"protocol": "rough"}, "protocol: expected one of official, smooth"),
    "protocol type": ({"protocol": []}, "protocol: expected one of official, smooth"),
    "dtype": ({"dtype": "float16"}, "dtype: expected"),
    "observation": ({"observation": "pixels"}, "observation: expected one of official, motion, image"),
    "image size unasked": ({"image_size": 84}, "image_size: expected none"),
    "image size": ({"observation": "image", "image_size": 0}, "image_size: expected a whole number of px"),
    "image size type": ({"observation": "image", "image_size": 8.0}, "image_size: expected a whole number of px"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_of_make_get_one_line(case: str) -> None:
    options, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        make(**({"id": "in-advance/support-v1"} | options))
    assert "\n" not in str(caught.value)


ACTIONS: dict[str, tuple[str, Any, str]] = {
    "text": ("on-the-fly", "1", "expected whole numbers, got dtype"),
    "none": ("on-the-fly", None, "expected whole numbers, got dtype object"),
    "half": ("on-the-fly", 0.5, "expected whole numbers, got dtype float64"),
    "flag": ("on-the-fly", True, "expected whole numbers, got dtype bool"),
    "two": ("on-the-fly", np.zeros(2, np.int32), "expected shape (), got (2,)"),
    "one time": ("in-advance", 0.5, "expected shape (6,), got ()"),
    "five times": ("in-advance", np.zeros(5), "expected shape (6,), got (5,)"),
    "seven times": ("combined", np.zeros(7), "expected shape (6,), got (7,)"),
    "rows": ("combined", np.zeros((6, 1)), "expected shape (6,), got (6, 1)"),
    "ragged": ("combined", [[1], [1, 2]], "expected an array, got rows of unequal length"),
    "words": ("in-advance", ["a"] * 6, "expected numbers, got dtype <U1"),
    "complex": ("in-advance", np.zeros(6, complex), "expected numbers, got dtype complex128"),
    "object": ("in-advance", {"a": 1}, "expected numbers, got dtype object"),
    "duration": ("in-advance", np.zeros(6, "timedelta64[s]"), "expected numbers, got dtype timedelta64[s]"),
}


@pytest.mark.parametrize("case", ACTIONS)
def test_bad_actions_get_one_line_before_jax_sees_them(case: str) -> None:
    strategy, action, message = ACTIONS[case]
    env, params = make(f"{strategy}/support-v1")
    state = jax.eval_shape(env.reset, jax.random.key(0), params)[1]  # nothing is compiled
    with pytest.raises(ValueError) as caught:
        env.step(jax.random.key(0), state, action, params)
    assert str(caught.value).startswith(f"action: {message}")
    assert "\n" not in str(caught.value)


def test_actions_of_every_number_type_are_taken() -> None:
    space = make("in-advance/support-v1")[0].action_space()
    half = jnp.full(6, 0.5, jnp.bfloat16)
    assert space.array(half).dtype == np.float32
    assert (space.array(half) == 0.5).all()
    assert jax.jit(lambda time: space.array([time] * 6))(0.5).tolist() == [0.5] * 6
    with pytest.raises(ValueError, match=r"^action: expected an array, got a tuple of 2"):
        jax.jit(lambda action: space.array((action, ())))(np.zeros(6))


def test_another_environments_params_and_state_are_refused() -> None:
    """The host would meet a topology that it has no program for, inside its callback."""
    env, params = environment()
    key, action = jax.random.key(0), env.action_space().sample(jax.random.key(0))
    state = jax.eval_shape(env.reset, key, params)[1]  # nothing is compiled
    others = (
        make("in-advance/basic-v1")[1],
        make("in-advance/support-v1", backend="xla")[1],
        make("in-advance/support-v1", protocol="smooth")[1],  # of the first reset
    )
    for other in others:
        for call in (partial(env.reset, key), partial(env.reset_to, 0), partial(env.step, key, state, action)):
            with pytest.raises(ValueError, match=r"^params: expected those of this environment"):
                call(other)
    traced, own = make("in-advance/support-v1", backend="xla")
    with pytest.raises(ValueError, match=r"^state: expected a state that reset or step of this environment"):
        traced.step(key, state, action, own)
    slow, its = make("on-the-fly/support-v1", protocol=EpisodeProtocol("slow", 10, 1))
    quick, _ = make("on-the-fly/support-v1", protocol=EpisodeProtocol("quick", 60, 1))
    with pytest.raises(ValueError, match=r"^state: expected a state .*, got one of another environment$"):
        quick.step(key, jax.eval_shape(slow.reset, key, its)[1], 0, its)  # its steps are counted at another rate
    other, its = make("on-the-fly/seesaw-v1")
    with pytest.raises(ValueError, match=r"^state: expected a state .*, got one of another environment$"):
        other.step(key, state, 0, its)
    with pytest.raises(ValueError, match=r"^params: expected those of this environment"):  # of first observations
        make("on-the-fly/support-v1", backend="xla")[0].reset(key, own)


def test_numbers_and_types_of_numpy_are_those_of_python() -> None:
    protocol = EpisodeProtocol("own", fps=60.0, resets=np.int64(1))  # type: ignore[arg-type]
    assert (protocol, type(protocol.fps), type(protocol.steps)) == (EpisodeProtocol("own", 60, 1), int, int)
    env, _ = make("on-the-fly/support-v1", dtype=np.dtype("float32"))  # type: ignore[arg-type]
    assert type(env.dtype) is str


def test_many_states_are_refused_without_vmap() -> None:
    """Their rows would be read as the words of one."""
    env, params = environment()
    states = jax.eval_shape(jax.vmap(env.reset, in_axes=(0, None)), keys(0), params)[1]
    for call in (
        partial(env.step, jax.random.key(0), states, 0),
        partial(env.info, states),
        partial(env.observe, states),
    ):
        with pytest.raises(
            ValueError, match=rf"^state: expected one state, got states of shape \({BATCH},\); jax.vmap"
        ):
            call(params)


@pytest.mark.parametrize("backend", ["host", "xla"])
def test_a_game_that_is_none(backend: Any) -> None:
    """An array is looked at if it has a value; a traced one stands for the nearest, with both backends."""
    env, params = make("on-the-fly/support-v1", backend=backend)
    with pytest.raises(ValueError, match=r"^game: expected a whole number of at least 0 and at most 0, got 5$"):
        env.reset_to(jnp.int32(5), params)
    reset = jax.jit(env.reset_to)
    expected = reset(jnp.int32(0), params)
    for game in (5, -1):
        assert_equal_trees(reset(jnp.int32(game), params), expected)


def test_blocks_outside_the_picture_are_seen_at_its_edge() -> None:
    hole = load_scene("hole")
    blocks = np.array(hole.blocks)
    blocks[list(hole.eliminable_blocks)[:2]] = [[[650, 300], [900, 300]], [[-300, 500], [-100, 500]]]
    candidates = scene_features(replace(hole, name="outside", blocks=blocks)).candidates
    np.testing.assert_array_equal(candidates[:2], np.array([[1, 0.5], [0, 500 / 600]], np.float32))


def test_a_raw_key_of_another_length_is_no_key() -> None:
    env, params = make("on-the-fly/support-v1")
    with pytest.raises(ValueError, match=r"^key: expected a random key"):
        env.reset(np.zeros(3, np.uint32), params)


@pytest.mark.parametrize("backend", ["host", "xla"])
@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly", "combined"])
@pytest.mark.parametrize("observation", ["official", "image"])
def test_no_number_is_promoted_unsaid(observation: Any, strategy: str, backend: Any) -> None:
    env, params = make(f"{strategy}/spring-v1", observation=observation, backend=backend)
    with jax.numpy_dtype_promotion("strict"):
        state = jax.eval_shape(env.reset, jax.random.key(0), params)[1]
        action = env.action_space().sample(jax.random.key(0))
        jax.eval_shape(env._step, jax.random.key(0), state, action, params)


@pytest.mark.parametrize("protocol", ["official", "smooth"])
def test_times_are_the_nearest_numbers_in_any_program(protocol: str) -> None:
    """XLA divides by a constant as it multiplies by its reciprocal, which is an ulp off for a time in three."""
    env, params = make("on-the-fly/support-v1", protocol=protocol, autoreset=False)

    def decide(state: Any, _: None) -> Any:
        _, state, _, _, _, info = env.step(jax.random.key(0), state, jnp.int32(0), params)
        return state, (info["time"], env.info(state, params)["time"])

    times = jax.lax.scan(decide, env.reset(jax.random.key(0), params)[1], length=150)[1]
    for found in times:
        np.testing.assert_array_equal(found, (np.arange(1, 151) / 10).astype(np.float32))


def test_numbers_beyond_32_bits_do_nothing() -> None:
    """Narrowed, 2**32 + 1 would be the first block."""
    env, params = environment()
    _, state = env.reset(jax.random.key(0), params)
    for action in (2**32 + 1, -(2**32) + 1, np.uint64(2**32 + 1)):
        info = env.step(jax.random.key(0), state, action, params)[-1]
        assert info["eliminations"] == 0
        with jax.enable_x64(True):
            assert env.action_space().array(jnp.asarray(np.asarray(action))) in (-1, env.num_actions)
    assert env.step(jax.random.key(0), state, np.int64(1), params)[-1]["eliminations"] == 1


def test_rates_whose_steps_cannot_be_counted_are_refused() -> None:
    protocol = EpisodeProtocol("own", fps=20_000, resets=1)
    with pytest.raises(ValueError, match=r"^fps: expected at most \d+ for scenes of this size, got 20000$"):
        make("on-the-fly/multi_ball_stack-v1", protocol=protocol)


def test_bad_scenes_are_refused() -> None:
    env, _ = environment()
    with pytest.raises(ValueError, match="expected topologies of this environment, but seesaw has another"):
        env.params(["seesaw"])
    for scenes in ([], "support", 3):
        with pytest.raises(ValueError, match="scenes: expected a sequence of at least one"):
            env.params(scenes)
    unreadable = ("two shelves-v1", "two(shelves)-v1", "a:b-v1", "mine-v01", "x-v\u0663", "\u00e4-v1", "mine-v1\n")
    for name in ("mine", "mine-v", "a/b-v1", "-v1", 3, *unreadable):  # to gymnasium, which then makes no id at all
        with pytest.raises(ValueError, match=r'name: expected the form "mine-v1"'):
            iphyre_jax.register(name, ["support"])
    with pytest.raises(ValueError, match="scenes: expected a sequence"):
        iphyre_jax.register("none-v1", [])


def test_ids_cover_the_games_and_splits() -> None:
    ids = set(iphyre_jax.environment_ids())
    assert {f"{s}/{g}-v1" for s in ("in-advance", "on-the-fly", "combined") for g in ("basic", "all", "hole")} <= ids
    assert environment()[0].params_of([load_scene("hole")]).n_games == 1


def test_a_name_may_be_registered_again() -> None:
    """A notebook cell that is run again; another meaning only if it is asked for."""
    for _ in range(2):
        builder = iphyre_jax.SceneBuilder("own")
        builder.block((200, 500), (300, 500), eliminable=True)
        builder.ball((250, 340), radius=20)
        iphyre_jax.register("again-v1", ["support", builder.build()])
    with pytest.raises(ValueError, match=r"^name: expected a free name, but again-v1 is .* say overwrite=True"):
        iphyre_jax.register("again-v1", ["hole"])
    iphyre_jax.register("again-v1", ["hole"], overwrite=True)
    assert iphyre_jax.make("on-the-fly/again-v1")[0].games == ("hole",)
    with pytest.raises(ValueError, match=r"^name: expected a free name, but hole-v1 is registered by this package$"):
        iphyre_jax.register("hole-v1", ["support"], overwrite=True)
