"""The ids that gymnax's own `make` takes."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any

from iphyre_jax.adapters.five_values import FiveValues
from iphyre_jax.adapters.gymnax_env import GymnaxEnv
from iphyre_jax.envs import environment_ids, make


def register_gymnax() -> tuple[str, ...]:
    """Register every id with gymnax, and return the names.

    `gymnax.make("iphyre/on-the-fly-hole-v1")` returns a `GymnaxEnv`, whose step has gymnax's six values, with
    `final_observation`; `gymnax.make("iphyre-five/on-the-fly-hole-v1")` a `FiveValues`, for trainers written before
    gymnax 1.0. Both come with their parameters and take the arguments of `iphyre_jax.make`. Names that are already
    registered stay.

    Raises:
        ImportError: gymnax is missing or older than 1.0; one line.
    """
    try:
        registration = import_module("gymnax.registration")
        registered, register = registration.registered_envs, registration.register
    except (ModuleNotFoundError, AttributeError):
        raise ImportError(
            "register_gymnax needs the extra 'gymnax' (gymnax 1.0 is missing): pip install 'iphyre-jax[gymnax]'"
        ) from None
    names = []
    for own in environment_ids():
        for prefix, factory in (("iphyre", _six_values), ("iphyre-five", _five_values)):
            name = f"{prefix}/{own.replace('/', '-')}"
            names.append(name)
            if name not in registered:
                register(name, partial(factory, own))
    return tuple(names)


def _six_values(own: str, **options: Any) -> GymnaxEnv:  # noqa: ANN401
    return GymnaxEnv(*make(own, **({"final_observation": True} | options)))


def _five_values(own: str, **options: Any) -> FiveValues:  # noqa: ANN401
    return FiveValues(*make(own, **options))
