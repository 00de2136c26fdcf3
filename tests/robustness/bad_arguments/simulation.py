"""Bad arguments of plans, rollouts and the solver."""

from __future__ import annotations

import jax
import numpy as np

import iphyre_jax
from iphyre_jax import physics
from tests.robustness.bad_arguments.given import (
    PLAN,
    hole,
    world,
)
from tests.robustness.bad_arguments.kinds import (
    ARRAY,
    FLAG,
    INF,
    NUMBER,
    SCENE,
    THING,
    WHOLE,
    WORD,
    Row,
    keywords,
)


def rows() -> list[Row]:
    """Return the rows of `simulate`, `simulate_many`, plans and rollouts."""
    sim, many, to_steps = iphyre_jax.simulate, iphyre_jax.simulate_many, iphyre_jax.plan_to_steps
    settings = {
        "fps": (*NUMBER, 0, -1, 1e-9, 1e9, 1e200),
        "duration": (*NUMBER, 0, -1, 1e9, 1e200, 0.01),
        "dtype": (*WORD, "float16", np.float32),
        "resets": (*WHOLE, 0, 10**12),
        "sample_every": (*WHOLE[1:], 0),
    }
    plans = (*ARRAY, [0, 1], [[-2]], [[0] * 9])
    topology, one, timing = world()
    steps = np.zeros(2, np.int32)
    return [
        *keywords("simulate", lambda **k: sim("hole", PLAN, **k), settings),
        *keywords("simulate_many", lambda **k: many(["hole"], [0], PLAN, **k), settings | {"share_prefixes": FLAG}),
        ("simulate", "scene", SCENE, lambda v: sim(v, PLAN)),
        ("simulate", "eliminate_at", plans, lambda v: sim("hole", v)),
        ("simulate", "eliminate_at", (np.zeros((1, 2), int),), jax.jit(lambda v: sim("hole", v).steps)),
        ("simulate", "sample_every", (np.zeros((10**6, 1), np.int8),), lambda v: sim("hole", v, sample_every=1)),
        ("simulate", "duration", (1e9,), lambda v: sim("hole", PLAN, duration=v, sample_every=1)),
        ("simulate", "mesh", (3, "cpu", [1]), lambda v: sim("hole", PLAN, mesh=v)),
        ("simulate_many", "scenes", (None, 3, "hole", hole()), lambda v: many(v, [0], PLAN)),
        ("simulate_many", "which", (*ARRAY[:7], [1], [-1], [[0]]), lambda v: many(["hole"], v, PLAN)),
        ("simulate_many", "eliminate_at", (*plans, [[0], [0]]), lambda v: many(["hole"], [0], v)),
        ("plan_to_steps", "times", ARRAY[:4], lambda v: to_steps(v, 60, "simulate")),
        ("plan_to_steps", "times", ([[-1.0]], [[INF]]), lambda v: to_steps(v, 60, "simulate")),
        ("plan_to_steps", "times", (np.ones((1, 10**5)),), lambda v: to_steps(v, 60, "in_advance")),
        (
            "plan_to_steps",
            "fps",
            (*NUMBER, 0, 59.94, 10**8),
            lambda v: to_steps([[1.0]], v, "simulate"),
        ),
        ("plan_to_steps", "rule", WORD, lambda v: to_steps([[1.0]], 60, v)),
        ("rollout", "topology", THING, lambda v: iphyre_jax.rollout(v, one, timing, steps, 1)),
        ("rollout", "world", THING, lambda v: iphyre_jax.rollout(topology, v, timing, steps, 1)),
        ("rollout", "timing", THING, lambda v: iphyre_jax.rollout(topology, one, v, steps, 1)),
        ("rollout", "plan", (None, [1], np.zeros(2), 3), lambda v: iphyre_jax.rollout(topology, one, timing, v, 1)),
        ("rollout", "steps", (*WHOLE[:4], 10**9), lambda v: iphyre_jax.rollout(topology, one, timing, steps, v)),
        ("compile_scene", "scene", THING, iphyre_jax.compile_scene),
        ("compile_scene", "resets", (*WHOLE, 0), lambda v: iphyre_jax.compile_scene(hole(), resets=v)),
        ("compile_scene", "dtype", WORD, lambda v: iphyre_jax.compile_scene(hole(), dtype=v)),
        ("step_timing", "fps", (*NUMBER, 0, 5e-324), lambda v: iphyre_jax.step_timing(v, "float32")),
        ("step_timing", "dtype", WORD, lambda v: iphyre_jax.step_timing(60, v)),
        ("physics.initial_state", "world", THING, lambda v: physics.initial_state(topology, v)),
        (
            "physics.step",
            "timing",
            THING,
            lambda v: physics.step(topology, one, v, physics.initial_state(topology, one)),
        ),
        ("physics.step", "state", THING, lambda v: physics.step(topology, one, timing, v)),
        ("physics.Topology", "balls", (*WHOLE, 16), lambda v: physics.Topology(1, v, 10, (), (), 4)),
        ("physics.Topology", "slots", (*WHOLE, 0, 10**9), lambda v: physics.Topology(1, 1, 10, (), (), v)),
        (
            "physics.Topology",
            "pins",
            (None, 3, ((0, 9),), ((0,),), (3,)),
            lambda v: physics.Topology(1, 1, 9, v, (), 4),
        ),
    ]
