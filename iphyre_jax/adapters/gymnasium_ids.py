"""The ids that gymnasium's own `make` and `make_vec` take."""

from __future__ import annotations

from typing import Any

import gymnasium

from iphyre_jax.adapters.gymnasium_env import GymnasiumEnv
from iphyre_jax.adapters.gymnasium_vector import GymnasiumVectorEnv
from iphyre_jax.envs import environment_ids


class RegisteredEnv(GymnasiumEnv):
    """A `GymnasiumEnv` whose id has another name, because gymnasium's functions have an argument `id` of their own."""

    def __init__(self, environment: str, **options: Any) -> None:  # noqa: ANN401
        super().__init__(environment, **options)


class RegisteredVectorEnv(GymnasiumVectorEnv):
    """A `GymnasiumVectorEnv` made as a `RegisteredEnv` is."""

    def __init__(self, environment: str, **options: Any) -> None:  # noqa: ANN401
        super().__init__(environment, **options)


def register_gymnasium() -> tuple[str, ...]:
    """Register every id with gymnasium, "in-advance/basic-v1" as "iphyre/in-advance-basic-v1", and return the names.

    `gymnasium.make` then returns a `GymnasiumEnv`, `gymnasium.make_vec` a `GymnasiumVectorEnv`, or, with
    vectorization_mode="sync" or "async", gymnasium's own vector environment of `GymnasiumEnv`s. Names that are already
    registered stay.
    """
    names = []
    for own in environment_ids():
        name = f"iphyre/{own.replace('/', '-')}"
        names.append(name)
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=f"{__name__}:RegisteredEnv",
                vector_entry_point=f"{__name__}:RegisteredVectorEnv",
                kwargs={"environment": own},
                order_enforce=True,
            )
    return tuple(names)
