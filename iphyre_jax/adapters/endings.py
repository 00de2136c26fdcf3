"""How an episode ends for libraries that tell its own end from a cut."""

from __future__ import annotations

from typing import Any

from iphyre_jax.envs.core import Environment


def gymnasium_flags(env: Environment, terminated: Any, truncated: Any) -> tuple[Any, Any]:  # noqa: ANN401
    """Return terminated and truncated by gymnasium's definition; scalars or arrays.

    An in-advance episode is one decision, so it always ends by itself: it is terminated, solved or not. Officially a
    failure is truncated; gymnasium's infos have the official flags, `official_terminated` and `official_truncated`.
    """
    if env.strategy.name == "in-advance":
        return terminated | truncated, terminated & False
    return terminated, truncated
