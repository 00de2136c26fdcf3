"""Parts of programs as one kernel of a GPU: played by an interpreter and lowered for CUDA, which needs no GPU."""

from __future__ import annotations

import warnings
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.gpu import one_kernel
from iphyre_jax.execution.gpu.one_kernel import BLOCK, blocks_in_one_kernel, in_one_kernel, kernel
from iphyre_jax.execution.programs import Advance, Score, pack_timing, world_layout
from iphyre_jax.scenes.compile import step_timing

pytestmark = pytest.mark.usefixtures("few_optimisations")

LANES = 40  # a whole block and a part of one
FPS = 10


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the package does where JAX's default device is a GPU."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")


@pytest.fixture
def kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU for which XLA has Triton."""
    monkeypatch.setattr(one_kernel, "kernels_run", lambda: True)


def operations(shared: dict[str, jax.Array], lanes: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """What the physics is made of: rows by a traced number, loops until no lane goes on, branches, words of flags."""
    table, flags, count = lanes["table"], lanes["flags"], lanes["count"]
    row = shared["row"]
    read = jax.lax.dynamic_index_in_dim(table, row, 0, keepdims=False)
    wide = jax.lax.dynamic_index_in_dim(table.reshape(2, 3, -1), row, 0, keepdims=False)
    far = jax.lax.dynamic_index_in_dim(table, row + 100, 0, keepdims=False)  # means the last row
    written = jax.lax.dynamic_update_index_in_dim(table, read * 2, row + 1, 0)
    any_lane = jnp.any(flags, axis=1)

    def turn(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        k, left = state
        return k + 1, jnp.where(left > 0, left - 1, left)

    turns, left = jax.lax.while_loop(lambda state: jnp.any(state[1] > 0), turn, (jnp.int32(0), count))
    summed = jax.lax.fori_loop(0, 3, lambda k, total: total + table[0] * k, jnp.zeros_like(read))
    branch = jax.lax.cond(any_lane[1], lambda: (read + 1, jnp.int32(3)), lambda: (read - 1, jnp.int32(4)))
    padded = jnp.pad(jnp.stack([read, far]), ((0, 1), (0, 0)))
    bits = jax.lax.bitcast_convert_type(read, jnp.int32)
    return {
        "written": written,
        "wide": wide,
        "far": far + shared["row"],
        "left": left + turns,
        "summed": summed + branch[0] * branch[1],
        "padded": padded,
        "cumulated": jnp.cumsum(count[None] + jnp.arange(4, dtype=jnp.int32)[:, None], axis=0),
        "reduced": jnp.max(table, axis=0) - jnp.min(table) + jnp.sum(any_lane),
        "flags": flags & ~any_lane[:, None] | (jnp.sum(flags, axis=0) > 1)[None],
        "words": (jax.lax.clz(bits) ^ jax.lax.population_count(bits)) << 2 >> 1,
        "nothing": table[:0],
    }


def test_a_kernel_gives_what_its_work_gives() -> None:
    rng = np.random.default_rng(0)
    shared = {"row": np.int32(1)}
    lanes = {
        "table": rng.normal(size=(6, LANES)).astype(np.float32),
        "flags": rng.random((5, LANES)) < [[0], [1], [0.5], [0.01], [0.9]],
        "count": rng.integers(0, 9, LANES).astype(np.int32),
    }
    expected = jax.jit(operations)(shared, lanes)
    # "any lane" means one of a block: so the blocks one by one.
    blocks = [
        jax.jit(operations)(shared, {name: part[..., start : start + 32] for name, part in lanes.items()})
        for start in (0, 32)
    ]
    found = jax.jit(partial(kernel, operations, interpret=True))(shared, lanes)
    for name, leaf in found.items():
        assert leaf.shape == expected[name].shape, name
        joined = np.concatenate([block[name] for block in blocks], -1)
        np.testing.assert_allclose(leaf, joined, rtol=1e-6, err_msg=name)


def doubled(shared: jax.Array, lanes: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return {"sum": lanes["table"] * 2 + shared, "any": jnp.any(lanes["flags"]) & lanes["flags"]}


def counted(shared: jax.Array, lanes: dict[str, jax.Array]) -> dict[str, jax.Array]:
    turns = jax.lax.while_loop(lambda k: jnp.any(lanes["table"][0] > k), lambda k: k + 1, jnp.int32(0))
    return {"sum": lanes["table"] + turns * shared, "any": ~lanes["flags"]}


@pytest.mark.parametrize("interpret", [False, True])
def test_each_block_does_its_own_work(interpret: bool, monkeypatch: pytest.MonkeyPatch, kernels: None) -> None:
    chosen, shared = jnp.array([1, 0, 0, 1], jnp.int32), jnp.float32(3)
    rng = np.random.default_rng(0)
    lanes = {
        "table": jnp.asarray(rng.integers(0, 9, (2, 4 * BLOCK)), jnp.float32),
        "flags": jnp.asarray(rng.random(4 * BLOCK) < 0.5),
    }
    works = (doubled, counted)
    if interpret:
        monkeypatch.setattr(one_kernel, "kernel", partial(kernel, interpret=True))
        monkeypatch.setattr(one_kernel, "_with_derivatives", lambda plain, as_kernel: as_kernel)
    found = jax.jit(partial(blocks_in_one_kernel, works))(chosen, shared, lanes)
    for k, work in enumerate(chosen):
        part = slice(k * BLOCK, (k + 1) * BLOCK)
        expected = works[int(work)](shared, {name: leaf[..., part] for name, leaf in lanes.items()})
        for name, leaf in expected.items():
            np.testing.assert_array_equal(found[name][..., part], leaf)


def program_of(kind: type[Score] | type[Advance], game: str, dtype: str) -> tuple[Any, list[Any]]:
    """A program for LANES worlds of a game, and its arguments."""
    scene = iphyre_jax.load_scene(game)
    topology, world = cached_world(scene, 1, dtype)
    program = kind(topology, dtype, LANES, 6)
    worlds = np.repeat(world_layout(topology, dtype).pack_many([world]), LANES, 1)
    blocks = len(scene.eliminable_blocks)
    plans = np.full((6, LANES), -1, np.int32)
    plans[:blocks] = np.random.default_rng(1).integers(-5, 25, (blocks, LANES))
    steps = np.array([40, 1][: 1 + (kind is Advance)], np.int32)
    given = [worlds, np.maximum(plans, -1), pack_timing(step_timing(FPS, dtype)), steps]
    if kind is Advance:
        episodes = program.arguments()[-1]
        given.append(np.zeros(episodes.shape, episodes.dtype))
    return program, given


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "game", "dtype"),
    [(Advance, "hole", "float64"), pytest.param(Score, "fill", "float32", marks=pytest.mark.further)],
)
def test_worlds_in_a_kernel_end_as_on_a_cpu(
    kind: type[Score], game: str, dtype: str, gpu: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In float64 to the last bit of all that is kept of an episode."""
    with jax.enable_x64(dtype == "float64"):
        program, (worlds, plans, timing, steps, *episodes) = program_of(kind, game, dtype)
        shared, lanes = (timing, steps), (worlds, plans, *episodes)
        found = jax.jit(partial(kernel, program.in_lanes, interpret=True))(shared, lanes)
        monkeypatch.undo()
        expected = np.asarray(jax.jit(program.in_lanes)(shared, lanes))
    np.testing.assert_array_equal(found, expected)
    assert len(np.unique(expected, axis=1).T) > 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "game", "dtype"),
    [
        (Score, "hole", "float32"),
        (Score, "seesaw", "float64"),
        (Advance, "spring_flick", "float32"),
        pytest.param(Advance, "hole", "float32", marks=pytest.mark.further),
        pytest.param(Advance, "seesaw", "float64", marks=pytest.mark.further),
        pytest.param(Score, "spring_flick", "float32", marks=pytest.mark.further),
    ],
)
def test_programs_become_one_kernel(kind: type[Score], game: str, dtype: str, gpu: None, kernels: None) -> None:
    with jax.enable_x64(dtype == "float64"), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        program, given = program_of(kind, game, dtype)
        text = jax.jit(program.run).trace(*given).lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("stablehlo.custom_call") == 1
    assert "stablehlo.while" not in text


@pytest.mark.slow
@pytest.mark.parametrize(
    "games", [["pendulum"], pytest.param(["support", "multi_ball_hole"], marks=pytest.mark.further)], ids=["one", "two"]
)
def test_a_decision_in_the_users_program_is_one_kernel(games: list[str], gpu: None, kernels: None) -> None:
    iphyre_jax.register(f"kernel-{len(games)}-v1", games)
    env, params = iphyre_jax.make(f"on-the-fly/kernel-{len(games)}-v1", backend="xla", observation="motion")
    assert len(env.topologies) == len(games)
    state = jax.eval_shape(jax.vmap(env.reset, in_axes=(0, None)), jax.random.split(jax.random.key(0), 5), params)[1]
    step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
    keys, actions = jax.random.split(jax.random.key(1), 5), jnp.zeros(5, jnp.int32)
    text = step.trace(keys, state, actions, params).lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("stablehlo.custom_call @__gpu") == 1
    assert text.count("stablehlo.while") == 1  # over slices of a batch; none over topologies


@pytest.mark.parametrize(
    ("kind", "capability", "runs"),
    [
        ("NVIDIA H100 80GB HBM3", "9.0", True),
        ("NVIDIA A100", "8.0", True),
        ("NVIDIA GeForce RTX 2080", "7.5", False),
        ("MI300X", "", False),
    ],
)
def test_gpus_without_triton_stay_plain(
    kind: str, capability: str, runs: bool, gpu: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {"compute_capability": capability} if capability else {}
    monkeypatch.setattr(jax, "devices", lambda: [SimpleNamespace(device_kind=kind, **known)])
    assert one_kernel.kernels_run() == runs


def test_on_a_cpu_nothing_changes() -> None:
    np.testing.assert_array_equal(in_one_kernel(lambda one, many: one + many, 1.0, np.arange(3.0)), [1, 2, 3])


def test_what_a_kernel_cannot_do_is_done_without_one(kernels: None) -> None:
    with pytest.warns(RuntimeWarning, match=r"^this version of JAX makes no kernel of the physics \(.* operation sort"):
        found = jax.jit(partial(in_one_kernel, lambda _, rows: jnp.sort(rows, axis=0), None))(
            jnp.array([[2.0, 1], [1, 3]])
        )
    np.testing.assert_array_equal(found, [[1, 1], [2, 3]])


def test_derivatives_are_those_of_the_plain_form(kernels: None) -> None:
    def work(shared: jax.Array, lanes: tuple[jax.Array, jax.Array]) -> jax.Array:
        table, count = lanes
        return jax.lax.fori_loop(0, 3, lambda _, rows: rows * table * shared, table) + count[None]

    table, count = jnp.arange(1.0, 9.0).reshape(2, 4), jnp.arange(4)
    found = jax.jvp(lambda rows: in_one_kernel(work, jnp.float32(2), (rows, count)), (table,), (jnp.ones_like(table),))
    np.testing.assert_allclose(found[0], 8 * table**4 + count[None])
    np.testing.assert_allclose(found[1], 32 * table**3)


def test_programs_for_a_cpu_stay_plain_beside_a_gpu(kernels: None) -> None:
    doubled = jax.jit(lambda rows: in_one_kernel(lambda factor, rows: rows * factor, 2, rows))
    np.testing.assert_array_equal(doubled(jnp.arange(3.0)), [0, 2, 4])
    for platform, calls in (("cpu", 0), ("cuda", 1)):
        text = doubled.trace(jnp.arange(3.0)).lower(lowering_platforms=(platform,)).as_text()
        assert text.count("custom_call") == calls


def test_a_mesh_of_gpus_has_a_kernel_each(gpu: None, kernels: None) -> None:
    program, given = program_of(Score, "hole", "float32")
    mesh = jax.make_mesh((1,), ("worlds",), axis_types=(jax.sharding.AxisType.Auto,))
    spread, whole = jax.sharding.PartitionSpec(None, "worlds"), jax.sharding.PartitionSpec()
    run = jax.shard_map(
        program.run, mesh=mesh, in_specs=(spread, spread, whole, whole), out_specs=(spread,), check_vma=False
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        text = jax.jit(run).trace(*given).lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("custom_call @__gpu") == 1


WRONG: dict[str, Any] = {
    "a slice of lanes": lambda _, rows: rows[:, :1] + rows,
    "a shift of lanes": lambda _, rows: jnp.pad(rows, ((0, 0), (1, 0)))[:, :-1],
    "a lane by its number": lambda _, rows: jax.lax.dynamic_slice(rows, (0, 3), (2, 1)) + rows,
    "a sum over lanes": lambda _, rows: rows + rows.sum(axis=1, keepdims=True),
    "a scan over rows": lambda _, rows: jax.lax.scan(lambda total, row: (total + row, total), rows[0], rows)[1],
    "no rows": lambda _, rows: rows[:0].sum(axis=0, keepdims=True) + rows,
}


@pytest.mark.parametrize("work", WRONG.values(), ids=list(WRONG))
def test_what_is_not_known_is_refused(work: Any) -> None:
    with pytest.raises(NotImplementedError, match=r" in a kernel"):
        jax.eval_shape(partial(kernel, work, interpret=True), None, jnp.ones((2, LANES)))


def test_edges_of_operations() -> None:
    """Rows written beyond the ends go to the ends, flags have a maximum, and a zero keeps its sign."""

    def work(row: jax.Array, lanes: jax.Array) -> tuple[jax.Array, ...]:
        one = jnp.ones((1, lanes.shape[-1]))
        low, high = (jax.lax.dynamic_update_slice(lanes, one, (row + far, 0)) for far in (-9, 9))
        some, every = (fold(lanes > 0, axis=1)[:, None] & (lanes == lanes) for fold in (jnp.max, jnp.min))
        zero = jax.lax.fori_loop(0, 1, lambda _, x: x, jnp.float32(-0.0))
        return low, high, some, every, 1 / zero + lanes

    lanes = jnp.stack([jnp.arange(-3.0, 3.0), jnp.zeros(6), jnp.ones(6)])
    found = jax.jit(partial(kernel, work, interpret=True))(jnp.int32(1), lanes)
    for one, other in zip(found, work(jnp.int32(1), lanes), strict=True):
        np.testing.assert_array_equal(one, other)
