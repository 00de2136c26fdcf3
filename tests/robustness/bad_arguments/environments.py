"""Bad arguments of environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

import iphyre_jax
from iphyre_jax import envs
from iphyre_jax.envs.in_advance import action_to_times
from iphyre_jax.envs.protocols import EpisodeProtocol
from tests.robustness.bad_arguments.given import (
    ID,
    KEY,
    acting,
    batch,
    made,
    policy,
    state,
)
from tests.robustness.bad_arguments.kinds import (
    ARRAY,
    FLAG,
    HUGE,
    NAN,
    NUMBER,
    THING,
    WHOLE,
    WORD,
    Row,
    keywords,
)


def rows() -> list[Row]:
    """Return the rows of environments."""
    env, params = made()
    make: dict[str, Sequence[Any]] = {
        "id": (None, 3, "", "in-advance", "in-advance/nonsense-v1", "x" * 10**6),
        "protocol": WORD,
        "dtype": WORD,
        "observation": WORD,
        "image_size": (1, HUGE),
        "autoreset": FLAG,
        "final_observation": FLAG,
        "official_bugs": FLAG,
        "limits": (3, "x", {}),
        "backend": WORD[1:],
    }
    evaluate: dict[str, Sequence[Any]] = {
        "policy": (None, 3, lambda obs: obs, lambda: 0, []),
        "split": (None, 3, "nonsense", np.array(["a", "b"])),
        "strategy": WORD,
        "protocol": WORD,
        "observation": WORD,
        "episodes": (*WHOLE, 0, 10**9),
        "key": (0, "x", 1.5, jax.random.split(KEY)),
        "dtype": WORD,
    }
    keys = (None, 0, "x", 1.5, np.zeros(2), jax.random.split(KEY))
    good: dict[str, Any] = {"policy": policy, "split": ["support"], "strategy": "in-advance"}
    unroll = lambda **k: envs.unroll(  # noqa: E731
        **({"environment": env, "policy": acting, "weights": 0, "batch": batch(), "key": KEY, "decisions": 1} | k)
    )
    play = lambda **k: iphyre_jax.play_plans(  # noqa: E731
        **({"scenes": ["support"], "which": [0], "actions": np.zeros((1, 6))} | k)
    )
    actions = (None, "x", 1.0, np.zeros((1, 5)), np.full((1, 6), NAN), np.full((1, 6), 2.0), [[0.5], [0.5, 1]])
    return [
        *keywords("make", lambda **k: iphyre_jax.make(**({"id": ID} | k)), make),
        (
            "register",
            "name",
            (None, 3, "mine", "mine-v", "a/b-v1", "a\n-v1", "x" * 10**6 + "-v1"),
            lambda v: iphyre_jax.register(v, ["hole"]),
        ),
        ("register", "scenes", (None, 3, "hole", []), lambda v: iphyre_jax.register("bad-v1", v)),
        ("Environment.reset", "key", keys, lambda v: env.reset(v, params)),
        ("Environment.reset", "params", THING, lambda v: env.reset(KEY, v)),
        ("Environment.reset_to", "game", (*WHOLE, 1, np.zeros(2, int)), lambda v: env.reset_to(v, params)),
        ("Environment.step", "key", keys, lambda v: env.step(v, state(), np.zeros(6), params)),
        ("Environment.step", "state", THING, lambda v: env.step(KEY, v, np.zeros(6), params)),
        (
            "Environment.step",
            "action",
            (None, "x", 1.0, np.zeros(5), [[1], [1, 2]]),
            lambda v: env.step(KEY, state(), v, params),
        ),
        ("Environment.observe", "state", THING, lambda v: env.observe(v, params)),
        ("Environment.info", "params", THING, lambda v: env.info(state(), v)),
        ("Environment.single_game", "game", (*WHOLE, 1), lambda v: env.single_game(params, v)),
        ("Environment.params", "scenes", (None, 3, "hole", [], ["seesaw"]), env.params),
        *keywords("evaluate", lambda **k: iphyre_jax.evaluate(**(good | k)), evaluate),
        *keywords(
            "unroll", unroll, {"decisions": (*WHOLE, 0, 10**9), "key": keys, "environment": THING, "batch": THING}
        ),
        ("unroll", "policy", (None, 3, policy, []), lambda v: unroll(policy=v)),
        ("Batch.of", "games", (*ARRAY[:6], [1], [], [-1]), lambda v: envs.Batch.of(env, params, v)),
        ("observation_table", "scenes", (None, 3, "hole", []), iphyre_jax.observation_table),
        *keywords("play_plans", play, {"fps": (*NUMBER, 0, 15, 10**8), "resets": (*WHOLE, 0, 10**12), "dtype": WORD}),
        ("play_plans", "which", (*ARRAY[:6], [1], [-1], [0, 0]), lambda v: play(which=v)),
        ("play_plans", "actions", actions, lambda v: play(actions=v)),
        ("action_to_times", "slots", (*WHOLE, 65), lambda v: action_to_times(np.zeros((1, 6)), v)),
        ("EpisodeProtocol", "fps", (*NUMBER, 0, 15), lambda v: EpisodeProtocol("mine", v, 1)),
        ("EpisodeProtocol", "resets", (*WHOLE, 0), lambda v: EpisodeProtocol("mine", 10, v)),
        ("Box", "shape", (None, 3, (-1,), (0.5,), (HUGE,)), lambda v: envs.Box(0.0, 1.0, v)),
        ("Box", "low", (None, "x", NAN, 2.0), lambda v: envs.Box(v, 1.0, (1,))),
        ("Box.sample", "shape", ((10**6, 10**6),), lambda v: envs.Box(0.0, 1.0, v).sample(KEY)),
        ("Discrete", "n", (*WHOLE, 0), envs.Discrete),
        ("configure", "devices", (*WHOLE[1:], 0, 10**9), lambda v: iphyre_jax.configure(devices=v)),
        ("configure", "compile_timeout", (*NUMBER[1:], 0, 1e300), lambda v: iphyre_jax.configure(compile_timeout=v)),
        ("configure", "cache", (3, [], b"x", "a\0b"), lambda v: iphyre_jax.configure(cache=v)),
    ]
