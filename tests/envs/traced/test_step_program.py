"""Decisions that are compiled apart and linked: which programs, when none, and the same bits as the plain form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.traced import cpu_batch, step_program
from iphyre_jax.envs.traced.step import TracedStep
from iphyre_jax.envs.traced.step_program import TopologyStep, linked_steps
from iphyre_jax.envs.traced.worlds import TracedWorlds
from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation import executables
from iphyre_jax.execution.compilation.compiler import CompilationError
from iphyre_jax.execution.compilation.description import describe, from_description
from iphyre_jax.execution.machine_code.linked import MOST_ROWS
from iphyre_jax.execution.machine_code.linking import can_link
from tests.trees import assert_equal_trees

pytestmark = pytest.mark.skipif(not can_link(), reason="links on Linux with x86-64")


def traced(games: list[str]) -> TracedStep:
    iphyre_jax.register("linked-v1", games, overwrite=True)
    worlds = iphyre_jax.make("on-the-fly/linked-v1", backend="xla")[0].worlds
    assert isinstance(worlds, TracedWorlds)
    return worlds.traced


@pytest.fixture
def wanted(monkeypatch: pytest.MonkeyPatch) -> list[TopologyStep]:
    """The list takes the programs that are asked for."""
    asked: list[TopologyStep] = []
    monkeypatch.setattr(step_program, "linked", lambda programs: asked.extend(programs))
    return asked


def test_a_batch_of_any_size_takes_the_same_programs(wanted: list[TopologyStep]) -> None:
    step = traced(["hole", "multi_ball_hole", "support"])
    for worlds in (1, 17, 1000):
        linked_steps(step, worlds, 3)
    assert len(wanted) == 3 * len(set(wanted)) == 6
    assert [program.topology_id for program in wanted[:2]] == [0, 1]
    assert not any(program.neighbours for program in wanted)


def test_the_table_of_games_is_of_three_sizes(wanted: list[TopologyStep]) -> None:
    step = traced(["hole"])
    for games in (1, 2, 30, 1000, 2000):
        linked_steps(step, 7, games)
    assert [program.games for program in wanted] == [1, *[wanted[0].lanes] * 2, *[MOST_ROWS] * 2]


def test_whole_groups_of_one_game_are_neighbours(wanted: list[TopologyStep]) -> None:
    step = traced(["hole"])
    for worlds, games in ((256, 1), (250, 1), (256, 2)):
        linked_steps(step, worlds, games)
    linked_steps(replace(step, keep_final=True), 256, 1)
    assert [program.neighbours for program in wanted] == [True, False, False, False]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:programs are compiled in this process")
def test_a_program_that_writes_whole_tables_is_found_out(wanted: list[TopologyStep]) -> None:
    """Its example ends the process that compiles it, and not this one."""
    linked_steps(traced(["hole"]), 7, 1)
    (program,) = wanted
    final = replace(program.step, keep_final=True)
    assert executables.linked([replace(program, step=final)])
    assert executables.linked([replace(program, step=final, neighbours=True)]) is None


def test_more_rows_than_a_program_is_made_for_are_not_linked(wanted: list[TopologyStep]) -> None:
    step = traced(["hole"])
    assert linked_steps(step, MOST_ROWS + 1, 1) is None
    assert linked_steps(step, 1, MOST_ROWS + 1) is None
    assert not wanted


def test_a_program_describes_itself_and_has_an_example(wanted: list[TopologyStep]) -> None:
    linked_steps(traced(["hole", "multi_ball_hole"]), 5, 2)
    for program in wanted:
        assert from_description(describe(program)) == program
        shapes, example = program.arguments(), program.example()
        assert [leaf.dtype for leaf in shapes] == [leaf.dtype for leaf in example]
        assert [leaf.shape[1:] for leaf in shapes] == [leaf.shape[1:] for leaf in example]
        assert max(leaf.shape[0] for leaf in example if leaf.ndim) <= 2 * program.lanes
        assert program.in_place == 4


def played(backend: Any = "xla") -> Any:
    """Some decisions of two topologies."""
    iphyre_jax.register("linked-v1", ["hole", "multi_ball_hole"], overwrite=True)
    with jax.enable_x64(True):
        env, params = iphyre_jax.make("on-the-fly/linked-v1", backend=backend, dtype="float64")
        keys = jax.random.split(jax.random.key(0), 5)
        obs, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)

        def turn(state: Any, action: jax.Array) -> Any:
            out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, state, action, params)
            return out[1], (out[0], *out[2:])

        actions = jnp.asarray(np.random.default_rng(0).integers(0, 7, (12, 5)), jnp.int32)
        return obs, jax.jit(lambda state: jax.lax.scan(turn, state, actions)[1])(state)


@pytest.mark.slow
def test_the_plain_form_plays_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no process compiles; a warning says so."""
    cpu_batch._play.clear_cache()
    linked = played()

    def refuse(jobs: Any, show: Any) -> None:
        raise CompilationError("no process today")

    tmp_path.chmod(0o700)
    settings = configuration._Settings(folder=tmp_path, folder_is_known=True)
    monkeypatch.setattr(configuration, "_settings", settings)
    monkeypatch.setattr(executables, "compile_all", refuse)
    monkeypatch.setattr(executables, "_loaded", {})
    cpu_batch._play.clear_cache()
    with pytest.warns(RuntimeWarning, match=r"without compiler options \(no process today\)"):
        plain = played()
    cpu_batch._play.clear_cache()
    assert_equal_trees(linked, plain)


@pytest.mark.slow
def test_the_example_begins_episodes_anew(wanted: list[TopologyStep]) -> None:
    """So what the compiling process plays first writes every table."""
    linked_steps(traced(["hole"]), 7, 1)
    (program,) = wanted
    (play,) = executables.linked([program]) or [None]
    assert play is not None
    (batch, first, last), out = jax.tree.unflatten(jax.tree.structure(program._shapes), program.example())
    start = batch.games.start._replace(obs=np.full_like(batch.games.start.obs, 7))
    batch = batch._replace(games=batch.games._replace(start=start))
    tables = jax.jit(play)(*jax.tree.leaves((batch, first, last, out)))
    obs = np.asarray(tables[2])
    assert obs.shape == (program.lanes + 1, 122)
    assert (obs == 7).all()
