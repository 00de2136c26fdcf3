"""The environments with the interfaces of other libraries; most need their library, an optional extra."""

from importlib import import_module
from typing import TYPE_CHECKING

from iphyre_jax.checks import missing_extra

if TYPE_CHECKING:
    from iphyre_jax.adapters.brax_env import BraxEnv, mend_brax
    from iphyre_jax.adapters.dm_environment import DmEnv
    from iphyre_jax.adapters.five_values import FiveValues
    from iphyre_jax.adapters.gymnasium_env import GymnasiumEnv
    from iphyre_jax.adapters.gymnasium_ids import register_gymnasium
    from iphyre_jax.adapters.gymnasium_vector import GymnasiumVectorEnv
    from iphyre_jax.adapters.gymnax_env import GymnaxEnv
    from iphyre_jax.adapters.gymnax_ids import register_gymnax
    from iphyre_jax.adapters.host_pool import HostPool
    from iphyre_jax.adapters.jumanji_env import JumanjiEnv
    from iphyre_jax.adapters.sb3_vec_env import SB3VecEnv

__all__ = [
    "BraxEnv",
    "DmEnv",
    "FiveValues",
    "GymnasiumEnv",
    "GymnasiumVectorEnv",
    "GymnaxEnv",
    "HostPool",
    "JumanjiEnv",
    "SB3VecEnv",
    "mend_brax",
    "register_gymnasium",
    "register_gymnax",
]

# Name: its module, and the extra that it needs.
_HOME = {
    "BraxEnv": ("brax_env", "brax"),
    "DmEnv": ("dm_environment", "dm-env"),
    "FiveValues": ("five_values", None),
    "GymnasiumEnv": ("gymnasium_env", "gymnasium"),
    "GymnasiumVectorEnv": ("gymnasium_vector", "gymnasium"),
    "GymnaxEnv": ("gymnax_env", None),
    "HostPool": ("host_pool", None),
    "JumanjiEnv": ("jumanji_env", "jumanji"),
    "SB3VecEnv": ("sb3_vec_env", "sb3"),
    "mend_brax": ("brax_env", "brax"),
    "register_gymnasium": ("gymnasium_ids", "gymnasium"),
    "register_gymnax": ("gymnax_ids", None),
}


def __getattr__(name: str) -> object:
    """Import an adapter on first use (PEP 562).

    Raises:
        ImportError: its library is missing; one line that names the extra.
    """
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, extra = _HOME[name]
    try:
        return getattr(import_module(f"{__name__}.{module}"), name)
    except ModuleNotFoundError as error:
        if extra is None or (error.name or "").partition(".")[0] == "iphyre_jax":
            raise
        raise missing_extra(name, extra, error.name) from None
