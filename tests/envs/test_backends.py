"""The two ways worlds are played inside a program, host and xla, and the host's in programs of every form."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs import Environment, EnvParams
from iphyre_jax.envs.core import BackendName
from iphyre_jax.envs.traced import batch
from iphyre_jax.execution.gpu import one_kernel
from tests.cases import further_but
from tests.trees import assert_equal_trees

BACKENDS: tuple[BackendName, ...] = ("host", "xla")
GAMES = ["support", "multi_ball_hole"]
# Strategy, games and options: two topologies once, for compiling both into one program takes long.
CASES = [
    pytest.param("on-the-fly", "backends-v1", {"observation": "motion", "final_observation": True}, id="on-the-fly"),
    pytest.param("combined", "pendulum-v1", {"autoreset": False}, id="combined", marks=pytest.mark.further),
    pytest.param("in-advance", "support-v1", {"protocol": "smooth"}, id="in-advance"),
]


@pytest.fixture(scope="session")  # a module's would come again in a worker that is handed one of its tests later
def two() -> str:
    iphyre_jax.register("backends-v1", GAMES)
    assert len(iphyre_jax.make("on-the-fly/backends-v1")[0].topologies) == 2
    return "backends-v1"


def actions_of(env: Environment, batch: tuple[int, ...], seed: int = 0) -> Any:
    """Hasty ones, so that blocks go and games end."""
    generator = np.random.default_rng(seed)
    if env.strategy.name == "on-the-fly":
        return jnp.asarray(generator.integers(0, 7, batch) * (generator.random(batch) < 0.2), jnp.int32)
    return jnp.asarray(generator.random((*batch, 6)) * 0.5, jnp.float32)


@partial(jax.jit, static_argnums=0)
def played(env: Environment, params: EnvParams, actions: jax.Array) -> Any:
    """Play actions (T, B, ...) in a scan; all that is ever told."""
    keys = jax.random.split(jax.random.key(0), actions.shape[:2])
    games = jnp.arange(actions.shape[1], dtype=jnp.int32) % params.n_games
    obs, state = jax.vmap(env.reset_to, in_axes=(0, None))(games, params)

    def turn(state: Any, given: Any) -> Any:
        out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(given[0], state, given[1], params)
        now = jax.vmap(env.observe, in_axes=(0, None))(out[1], params)
        return out[1], (out[0], *out[2:], now, jax.vmap(env.info, in_axes=(0, None))(out[1], params))

    return obs, jax.lax.scan(turn, state, (keys, actions))[1]


@pytest.mark.slow
@pytest.mark.usefixtures("two")
@pytest.mark.parametrize(("strategy", "games", "options"), CASES)
def test_both_backends_tell_the_same(strategy: str, games: str, options: dict[str, Any]) -> None:
    """In float64, to the last bit: what is seen, rewards, flags and infos, autoreset included."""
    told = []
    with jax.enable_x64(True):
        for backend in BACKENDS:
            env, params = iphyre_jax.make(f"{strategy}/{games}", dtype="float64", backend=backend, **options)
            actions = actions_of(env, (160 if strategy == "on-the-fly" else 8, 5))
            told.append(played(env, params, actions))
    assert_equal_trees(*told)
    terminated, truncated = told[0][1][2:4]
    assert (terminated | truncated).any()
    assert told[0][1][4]["eliminations"].max() > 0


@pytest.mark.slow
@pytest.mark.further
def test_both_backends_tell_the_same_of_all_games() -> None:
    told = []
    with jax.enable_x64(True):
        for backend in BACKENDS:
            env, params = iphyre_jax.make("on-the-fly/all-v1", dtype="float64", backend=backend, final_observation=True)
            told.append(played(env, params, actions_of(env, (160, 80))))
    assert_equal_trees(*told)


@pytest.mark.slow
@pytest.mark.further
@pytest.mark.parametrize("kernels", [False, True])
def test_what_accelerators_do_for_several_games(two: str, kernels: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """All lanes choose between their episode and the next one, where a CPU copies rows; with kernels the worlds of all
    topologies play side by side. Bits are the host's."""
    monkeypatch.setattr(batch, "on_cpu", lambda: False)
    if kernels:
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
        monkeypatch.setattr(one_kernel, "kernels_run", lambda: True)
    monkeypatch.setattr(batch, "MOST_OF_DEVICE", 40)  # slices overlap, and have several blocks of a topology
    side_by_side, play_blocks = [], batch._play_blocks
    monkeypatch.setattr(batch, "_play_blocks", lambda *given: side_by_side.append(given) or play_blocks(*given))
    batch._differentiable.cache_clear()
    played.clear_cache()
    told = []
    with jax.enable_x64(True):
        for backend in BACKENDS:  # nobody else has these environments: their programs are traced here
            options: Any = {"protocol": "smooth", "final_observation": True, "backend": backend}
            options["observation"] = "motion" if kernels else "official"
            env, params = iphyre_jax.make(f"on-the-fly/{two}", dtype="float64", **options)
            told.append(played(env, params, actions_of(env, (160, 75))))
    batch._differentiable.cache_clear()
    assert_equal_trees(*told)
    assert (told[0][1][2] | told[0][1][3]).any()
    assert bool(side_by_side) == kernels


@pytest.mark.slow
@pytest.mark.parametrize("name", GAMES)
def test_parameters_may_have_one_game_of_several_topologies(two: str, name: str) -> None:
    told = []
    options: dict[str, Any] = {"dtype": "float64", "observation": "motion", "final_observation": True}
    with jax.enable_x64(True):
        for backend in BACKENDS:
            env, _ = iphyre_jax.make(f"on-the-fly/{two}", backend=backend, **options)
            params = env.params([iphyre_jax.load_scene(name)])
            told.append([played(env, params, actions_of(env, (20, worlds))) for worlds in (1, 5, 160)])
    assert_equal_trees(*told)


@pytest.mark.slow
def test_worlds_play_in_groups_where_no_kernel_can_be_made(two: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise NotImplementedError("of a test")

    monkeypatch.setattr(one_kernel, "kernels_run", lambda: True)
    monkeypatch.setattr(one_kernel, "kernel", refuse)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    groups, play_groups = [], batch._play_groups
    monkeypatch.setattr(batch, "_play_groups", lambda *given: groups.append(given) or play_groups(*given))
    batch._differentiable.cache_clear()
    env, params = iphyre_jax.make(f"on-the-fly/{two}", backend="xla", observation="motion", autoreset=False)
    keys, actions = jax.random.split(jax.random.key(0), 3), jnp.zeros(3, jnp.int32)
    _, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
    step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
    with pytest.warns(RuntimeWarning, match="no kernel of the physics .* of a test"):
        jax.eval_shape(step, keys, state, actions, params)
    batch._differentiable.cache_clear()
    assert groups


@pytest.mark.slow
def test_a_game_plays_in_a_mixture_as_alone() -> None:
    """Hole, pendulum and spring share a topology; alone none has a constraint that it lacks."""
    iphyre_jax.register("shared-v1", ["hole", "pendulum", "spring"])
    with jax.enable_x64(True):
        made = {
            backend: iphyre_jax.make("on-the-fly/shared-v1", dtype="float64", autoreset=False, backend=backend)
            for backend in BACKENDS
        }
        env, params = made["host"]
        actions = actions_of(env, (60, 3))
        mixed = played(env, params, actions)
        assert mixed[1][4]["eliminations"].max(axis=0).min() > 0
        for info in (mixed[1][4], mixed[1][6]):
            np.testing.assert_array_equal(info.pop("game")[0], np.arange(3))
        for game, backend in ((0, "host"), (1, "host"), (2, "host"), (1, "xla")):
            of, table = made[backend]
            one, own = of.single_game(table, game)
            assert [len(topology.constraint_ends) for topology in (*of.topologies, *one.topologies)] == [2, game > 0]
            obs, rest = played(one, own, actions[:, game : game + 1])
            assert not any(info.pop("game").any() for info in (rest[4], rest[6]))
            np.testing.assert_array_equal(obs[0], mixed[0][game])
            for leaf, among in zip(*map(jax.tree.leaves, (rest, mixed[1])), strict=True):
                np.testing.assert_array_equal(leaf[:, 0], among[:, game])


@pytest.mark.slow
@pytest.mark.parametrize("backend", further_but(BACKENDS, "host"))
def test_any_form_of_batch_gives_the_same(two: str, backend: BackendName) -> None:
    """One world, axes within axes, parameters of its own for each world, without jit."""
    with jax.enable_x64(True):  # in float32 a program of another form may round otherwise, if it is the user's
        env, params = iphyre_jax.make(f"on-the-fly/{two}", autoreset=False, dtype="float64", backend=backend)
        games, actions = jnp.arange(6, dtype=jnp.int32) % 2, actions_of(env, (6,), 1)
        key = jax.random.key(0)

        def play(game: jax.Array, action: jax.Array, params: EnvParams) -> Any:
            obs, state = env.reset_to(game, params)
            out = env.step(key, state, action, params)
            return obs, out[0], out[2:], env.step(key, out[1], action, params)[0]

        expected = jax.vmap(play, in_axes=(0, 0, None))(games, actions, params)

        def assert_same(given: Any) -> None:
            for one, other in zip(jax.tree.leaves(given), jax.tree.leaves(expected), strict=True):
                np.testing.assert_array_equal(one, other)

        singles = [play(game, action, params) for game, action in zip(games, actions, strict=True)]
        assert_same(jax.tree.map(lambda *rows: jnp.stack(rows), *singles))
        twice = jax.vmap(jax.vmap(play, in_axes=(0, 0, None)), in_axes=(0, 0, None))
        nested = twice(games.reshape(2, 3), actions.reshape(2, 3), params)
        assert_same(jax.tree.map(lambda leaf: leaf.reshape(6, *leaf.shape[2:]), nested))
        own = jax.tree.map(lambda leaf: jnp.repeat(leaf[None], 6, axis=0), params)
        assert_same(jax.jit(jax.vmap(play))(games, actions, own))
        one_game = [env.single_game(params, int(game))[1] for game in games[:2]]
        assert one_game[0].n_games == 1
        with jax.disable_jit():
            assert_same(jax.vmap(play, in_axes=(0, 0, None))(games, actions, params))
        none = jax.vmap(play, in_axes=(0, 0, None))(games[:0], actions[:0], params)
        for one, other in zip(jax.tree.leaves(none), jax.tree.leaves(expected), strict=True):
            assert one.shape == (0, *other.shape[1:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("game", "kernels", "rtol"),
    [("hole", False, 1e-7), pytest.param("multi_ball_redirect", True, 3e-5, marks=pytest.mark.further)],
)
def test_a_traced_state_has_derivatives(game: str, kernels: bool, rtol: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an observation by the state before the decision, in every form, beside differences; kernels or not.

    The games have other topologies: JAX would not trace a program again. An observation near 1 is rounded to 6e-8, so a
    difference over 2e-3 to 3e-5.
    """
    made, kernel = [], one_kernel.kernel
    monkeypatch.setattr(one_kernel, "kernel", lambda *given: made.append(given) or kernel(*given))
    if kernels:
        monkeypatch.setattr(one_kernel, "kernels_run", lambda: True)
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with jax.enable_x64(True):
        env, params = iphyre_jax.make(f"on-the-fly/{game}-v1", dtype="float64", observation="motion", backend="xla")
        key = jax.random.key(0)
        _, state = env.reset(key, params)
        for _ in range(3):  # falling
            _, state, *_ = env.step(key, state, 0, params)
        leaves, structure = jax.tree.flatten(state)
        (at,) = [k for k, leaf in enumerate(leaves) if leaf.dtype == jnp.float64]

        def seen(numbers: jax.Array) -> jax.Array:
            changed = jax.tree.unflatten(structure, [*leaves[:at], numbers, *leaves[at + 1 :]])
            return env.step(key, changed, 0, params)[0]

        numbers = leaves[at]
        slopes = jax.jacfwd(seen)(numbers)
        row = int(jnp.argmax(jnp.abs(slopes).max(axis=0)))
        way = jnp.zeros_like(numbers).at[row].set(1.0)
        assert jnp.abs(slopes[:, row]).max() > 1e-4
        np.testing.assert_array_equal(jax.jit(lambda at: jax.jvp(seen, (at,), (way,)))(numbers)[1], slopes[:, row])
        both = jax.vmap(lambda at: jax.jvp(seen, (at,), (way,)))(jnp.stack([numbers, numbers]))[1]
        np.testing.assert_array_equal(both, jnp.stack([slopes[:, row]] * 2))
        difference = (seen(numbers + 1e-3 * way) - seen(numbers - 1e-3 * way)) / 2e-3
        np.testing.assert_allclose(slopes[:, row], difference, rtol, atol=1e-6)
    assert bool(made) == kernels


@pytest.mark.slow
def test_calls_leave_no_trace(two: str) -> None:
    """The same call gives the same, whatever was asked for in between."""
    env, params = iphyre_jax.make(f"on-the-fly/{two}")
    others = env.params([GAMES[1], GAMES[0], GAMES[0]])
    actions = actions_of(env, (40, 7))
    first = played(env, params, actions)
    between = played(env, others, actions)
    again = played(env, params, actions)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    # The same games under other numbers, each with the same actions.
    swapped = played(env, others, actions[:, np.array([1, 0, 2])])
    np.testing.assert_array_equal(swapped[0][:2], np.asarray(first[0])[[1, 0]])
    assert between[0].shape == first[0].shape


@pytest.mark.slow
def test_a_step_leaves_its_state_as_it_was(two: str) -> None:
    """The host may write a state where it is, if nobody else has it."""
    env, params = iphyre_jax.make(f"on-the-fly/{two}", final_observation=True)
    keys, actions = jax.random.split(jax.random.key(0), 7), jnp.arange(7, dtype=jnp.int32)
    state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)[1]
    kept, state = jax.tree.map(np.array, state), jax.tree.map(jnp.asarray, state)
    step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
    first = step(keys, state, actions, params)

    def both(state: Any) -> Any:
        later, _ = jax.lax.scan(lambda now, _: (step(keys, now, actions, params)[1], now), state, length=3)
        return (
            state,
            step(keys, state, actions, params),
            later,
            env.info(jax.tree.map(lambda leaf: leaf[2], state), params),
        )

    told, again, later, _ = jax.jit(both)(state)
    for one in (told, state):
        assert_equal_trees(one, kept)
    assert_equal_trees(again, first)
    assert_equal_trees(step(keys, state, actions, params), first)
    with jax.disable_jit():
        assert_equal_trees(step(keys, state, actions, params), first)
    # As constants of the program, used twice, and donated.
    captured = jax.jit(lambda actions: (step(keys, state, actions, params), step(keys, state, actions, params)))
    for told in (*captured(actions), *captured(actions)):
        assert_equal_trees(told, first)
    donating = jax.jit(lambda state: step(keys, state, actions, params), donate_argnums=0)
    assert_equal_trees(donating(jax.tree.map(jnp.array, state)), first)
    assert_equal_trees(state, kept)
    assert any((one != other).any() for one, other in zip(*map(jax.tree.leaves, (later, kept)), strict=True))
    # One state for all, and one action.
    one = jax.tree.map(lambda leaf: leaf[3], state)
    alike = jax.vmap(env.step, in_axes=(None, None, 0, None))(keys[3], one, jnp.full(4, 3, jnp.int32), params)
    drawn = jax.vmap(env.step, in_axes=(0, None, None, None))(jnp.stack([keys[3]] * 4), one, jnp.int32(3), params)
    for out in (alike, drawn):
        for row in range(4):
            assert_equal_trees(
                jax.tree.map(lambda leaf, row=row: leaf[row], out), jax.tree.map(lambda leaf: leaf[3], first)
            )
    assert_equal_trees(jax.tree.map(lambda leaf: leaf[3], state), one)


@pytest.mark.slow
def test_a_world_plays_alike_in_every_group_and_call(two: str) -> None:
    """1,050 worlds of each topology: eight groups of lanes in a first call, a part of one in a second."""
    env, params = iphyre_jax.make(f"on-the-fly/{two}", autoreset=False)
    actions = actions_of(env, (60, 14))  # both games, seven times
    few, many = played(env, params, actions), played(env, params, jnp.tile(actions, (1, 150)))
    assert (few[1][2] | few[1][3]).any()
    np.testing.assert_array_equal(many[0], np.tile(few[0], (150, 1)))
    for one, other in zip(*map(jax.tree.leaves, (many[1], few[1])), strict=True):
        own = np.asarray(other)
        np.testing.assert_array_equal(one, np.tile(own, (1, 150, *[1] * (own.ndim - 2))))


@pytest.mark.slow
def test_threads_step_the_same_games_at_once() -> None:
    """In batches of several sizes: each has other games in its lanes."""
    iphyre_jax.register("threads-v1", ["support", "hole"])
    env, params = iphyre_jax.make("on-the-fly/threads-v1")
    assert len(env.topologies) == 1
    actions = [actions_of(env, (100, worlds), worlds) for worlds in (40, 60, 80, 100)]
    expected = [played(env, params, own) for own in actions]
    with ThreadPoolExecutor(4) as threads:
        for _ in range(3):
            told = threads.map(partial(played, env, params), actions)
            for one, other in zip(told, expected, strict=True):
                assert_equal_trees(one, other)


SCRIPT = """
import hashlib
import jax, jax.numpy as jnp, numpy as np
import iphyre_jax
{call}
iphyre_jax.register("own-v1", ["hole", "multi_ball_hole"])
env, params = iphyre_jax.make("on-the-fly/own-v1")
keys = jax.random.split(jax.random.key(0), 6)
seen, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
step = jax.vmap(env.step, in_axes=(0, 0, 0, None))
actions = jnp.asarray(np.random.default_rng(0).integers(0, 7, (200, 6)), jnp.int32)
first = step(keys, state, actions[0], params)  # not jitted
def turn(state, action):
    out = step(keys, state, action, params)
    return out[1], (out[0], *out[2:])
told = first[2:], jax.jit(lambda state: jax.lax.scan(turn, state, actions)[1])(state)
{then}
print(hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(told))).hexdigest())
"""
# An ordinary program: a scatter in a loop, the gradient of a convolution, a step of optax.
ORDINARY = """
import optax
ring = jax.jit(lambda ring: jax.lax.fori_loop(0, 9, lambda k, ring: ring.at[k % 4].set(k * ring[k % 3]), ring))
assert ring(jnp.ones((4, 5))).shape == (4, 5)
def loss(weights, image):
    return jax.lax.conv(image, weights, (1, 1), "SAME").sum() ** 2
weights, image = jnp.ones((3, 2, 3, 3)), jnp.ones((4, 2, 8, 8))
optimiser = optax.adam(1e-3)
@jax.jit
def learn(weights, memory):
    gradient = jax.grad(loss)(weights, image)
    change, memory = optimiser.update(gradient, memory)
    return optax.apply_updates(weights, change), memory
weights, _ = learn(weights, optimiser.init(weights))
assert np.isfinite(np.asarray(weights)).all()
"""


def told(call: str = "", then: str = "", flags: str = "") -> str:
    around = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    environment = {**around, **({"XLA_FLAGS": flags} if flags else {})}
    code = SCRIPT.format(call=call, then=then)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_a_mixture_inside_a_program_of_a_process_of_its_own() -> None:
    """Two topologies, stepped with and without jit, beside an ordinary program: whatever was called or set first."""
    plain = told(then=ORDINARY)
    assert len(plain) == 2 * hashlib.sha256().digest_size
    assert told("iphyre_jax.configure()") == plain
    assert told(flags="--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true") == plain


SPREAD = """
import sys
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_disable_most_optimizations", True)
from jax.sharding import AxisType, NamedSharding, PartitionSpec
import iphyre_jax
from iphyre_jax.execution.machine_code.linking import can_link
builder = iphyre_jax.SceneBuilder("steps")  # one body too, but of another topology
for k in range(11):
    builder.block((50 * k, 300), (50 * k + 30, 300), eliminable=k < 2)
builder.ball((65, 250), radius=15)
iphyre_jax.register("spread-v1", ["hole", builder.build()])
assert len(iphyre_jax.make("on-the-fly/spread-v1")[0].topologies) == 2
mesh = jax.make_mesh((2,), ("worlds",), axis_types=(AxisType.Auto,))
rows, whole = NamedSharding(mesh, PartitionSpec("worlds")), NamedSharding(mesh, PartitionSpec())
env, params = iphyre_jax.make(f"on-the-fly/{sys.argv[1]}-v1", backend="xla")
keys = jax.random.split(jax.random.key(0), 8)
state = jax.jit(jax.vmap(env.reset, in_axes=(0, None)))(keys, params)[1]
actions = jnp.arange(8, dtype=jnp.int32) % 7
step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
alone = step(keys, state, actions, params)
given = *jax.device_put((keys, state, actions), rows), jax.device_put(params, whole)
compiled = step.lower(*given).compile()
for one, other in zip(*map(jax.tree.leaves, (compiled(*given), alone)), strict=True):
    np.testing.assert_array_equal(one, other)
    assert one.sharding.spec[:1] == ("worlds",), one.sharding
text = compiled.as_text()
assert not any(name in text for name in ("all-gather", "all-reduce", "all-to-all", "collective-permute")), text
linked = [line for line in text.splitlines() if 'custom_call_target="iphyre_jax_' in line]
functions = [line for line in text.splitlines() if " call(" in line and "xla_cpu_small_call" in line]
functions = [line for line in functions if "inlineable" in line]
assert len(linked if can_link() else functions) == len(env.topologies), text
print("done")
"""


@pytest.mark.slow
@pytest.mark.parametrize("games", [pytest.param("hole", marks=pytest.mark.further), "spread"])
def test_each_device_plays_its_own_worlds(games: str) -> None:
    """With `backend="xla"` and a batch spread over two devices: nothing is exchanged, each world stays where it is."""
    flags = "--xla_force_host_platform_device_count=2 --xla_backend_optimization_level=0"
    environment = {**os.environ, "XLA_FLAGS": flags}
    command = [sys.executable, "-c", SPREAD, games]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "done", done.stderr
