"""Bad arguments of adapters and official names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from iphyre_jax import adapters, compat
from iphyre_jax.compat.actions import generate_actions
from iphyre_jax.compat.data import save_sequences
from tests.robustness.bad_arguments.given import (
    ID,
    OUT,
    made,
    simulator,
    single,
    vector,
)
from tests.robustness.bad_arguments.kinds import (
    FLAG,
    HUGE,
    NAN,
    NUMBER,
    SCENE,
    THING,
    WHOLE,
    Row,
    keywords,
)


def rows() -> list[Row]:
    """Return the rows of the adapters and of the official names."""
    generate: dict[str, Sequence[Any]] = {
        "num_succeed": (*WHOLE, 10**9),
        "num_fail": (*WHOLE, 10**9),
        "interval": (*NUMBER, 0, -1, 1e-12),
        "max_game_time": (*NUMBER, 0),
        "max_action_time": (*NUMBER, 0, 16, 1e300),
        "max_step": (*WHOLE, 1, 10**9),
        "seed": (*WHOLE, 2**32),
        "epsilon": (*NUMBER, -0.1, 1.1),
    }
    good = {"game": "hole", "num_succeed": 1, "num_fail": 1, "interval": 0.1}
    good |= {"max_game_time": 15, "max_action_time": 15, "max_step": 6}
    images = [[1, 2, HUGE], [1], "abc", None, [NAN, 1, 1]]
    sequences = lambda **k: save_sequences(  # noqa: E731
        **({"simulator": simulator(), "save_path": str(OUT), "act_lists": [], "fps": 10, "images": False} | k)
    )
    return [
        (
            "GymnasiumEnv",
            "render_mode",
            (3, "human", []),
            lambda v: adapters.GymnasiumEnv(ID, render_mode=v),
        ),
        ("GymnasiumEnv", "autoreset", (True,), lambda v: adapters.GymnasiumEnv(ID, autoreset=v)),
        ("GymnasiumEnv.reset", "seed", (*WHOLE[1:], 2**63), lambda v: single().reset(seed=v)),
        ("GymnasiumEnv.reset", "options", (3, "x", [1]), lambda v: single().reset(options=v)),
        ("GymnasiumEnv.reset", "options", ("x", 1, 1.5, HUGE), lambda v: single().reset(options={"game": v})),
        (
            "GymnasiumEnv.step",
            "reset",
            (np.zeros(6),),
            lambda v: adapters.GymnasiumEnv(ID).step(v),
        ),
        (
            "GymnasiumVectorEnv",
            "num_envs",
            (*WHOLE, 0, 10**9),
            lambda v: adapters.GymnasiumVectorEnv(ID, v),
        ),
        ("GymnasiumVectorEnv.reset", "seed", (*WHOLE[1:], [1, "x"], [1, -1]), lambda v: vector().reset(seed=v)),
        ("GymnasiumVectorEnv.reset", "options", (3, {"game": 1}), lambda v: vector().reset(options=v)),
        ("FiveValues", "env", THING, lambda v: adapters.FiveValues(v, made()[1])),
        ("FiveValues", "default_params", THING, lambda v: adapters.FiveValues(made()[0], v)),
        ("IPHYRE", "scene", SCENE, compat.IPHYRE),
        ("IPHYRE", "fps", (*NUMBER, 0, 1e9), lambda v: compat.IPHYRE("hole", v)),
        ("IPHYRE.step", "pos", (None, 3, [1], [1, 2, 3], "ab", [HUGE, 1], [NAN, 1]), lambda v: simulator().step(v)),
        ("IPHYRE.step", "use_images", FLAG, lambda v: simulator().step((1, 1), v)),
        ("IPHYRE.simulate", "action", (None, 3, "x", *([one] for one in images)), lambda v: simulator().simulate(v)),
        ("IPHYRE.collect_seq_data", "fps", (None, 0, 7, 2.5, True, HUGE), lambda v: sequences(fps=v)),
        ("IPHYRE.collect_seq_data", "act_lists", (None, 3, "x"), lambda v: sequences(act_lists=v)),
        ("IPHYRE.collect_seq_data", "save_path", (None, 3, "a\0b"), lambda v: sequences(save_path=v)),
        *keywords("generate_actions", lambda **k: generate_actions(**(good | k)), generate),
    ]
