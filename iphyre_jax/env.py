"""Deprecated names of the in-advance environment."""

from iphyre_jax._deprecated import moved

__getattr__ = moved(
    __name__,
    {
        "play": ("iphyre_jax", "play_plans"),
        "observation_table": ("iphyre_jax", "observation_table"),
        "action_to_times": ("iphyre_jax.envs.in_advance", "action_to_times"),
        "Episodes": ("iphyre_jax.envs.in_advance", "PlanResults"),
    },
)
