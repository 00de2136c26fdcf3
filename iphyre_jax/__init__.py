"""I-PHYRE in JAX: forty games of interactive physical reasoning, in a batched simulator that agrees with pymunk.

Everything public is named here and imported on first use, so that `import iphyre_jax` is quick, needs nothing beyond
jax and numpy, starts no JAX backend and sets no global flag.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from iphyre_jax.envs import Environment, EnvParams, EnvState, Scores, environment_ids, evaluate, make, register
    from iphyre_jax.envs.in_advance import observation_table, play_plans
    from iphyre_jax.execution.configuration import Configuration, configure
    from iphyre_jax.plans import plan_to_steps
    from iphyre_jax.rollouts import rollout
    from iphyre_jax.scenes import GAMES, SPLITS, Limits, Scene, SceneBuilder, load_scene, vary
    from iphyre_jax.scenes.compile import compile_scene, step_timing
    from iphyre_jax.simulation import Simulation, simulate, simulate_many

__version__ = "0.1.0"

__all__ = [
    "GAMES",
    "SPLITS",
    "Configuration",
    "EnvParams",
    "EnvState",
    "Environment",
    "Limits",
    "Scene",
    "SceneBuilder",
    "Scores",
    "Simulation",
    "__version__",
    "compile_scene",
    "configure",
    "environment_ids",
    "evaluate",
    "load_scene",
    "make",
    "observation_table",
    "plan_to_steps",
    "play_plans",
    "register",
    "rollout",
    "simulate",
    "simulate_many",
    "step_timing",
    "vary",
]

# No module may bear the name of something exported here: importing the module would put it in the function's place.
_HOME = {
    "GAMES": "scenes",
    "SPLITS": "scenes",
    "Limits": "scenes",
    "Scene": "scenes",
    "SceneBuilder": "scenes",
    "load_scene": "scenes",
    "vary": "scenes",
    "compile_scene": "scenes.compile",
    "step_timing": "scenes.compile",
    "Simulation": "simulation",
    "simulate": "simulation",
    "simulate_many": "simulation",
    "plan_to_steps": "plans",
    "rollout": "rollouts",
    "Environment": "envs",
    "EnvParams": "envs",
    "EnvState": "envs",
    "Scores": "envs",
    "environment_ids": "envs",
    "evaluate": "envs",
    "make": "envs",
    "register": "envs",
    "observation_table": "envs.in_advance",
    "play_plans": "envs.in_advance",
    "configure": "execution.configuration",
    "Configuration": "execution.configuration",
}


def __getattr__(name: str) -> object:
    """Import a public name from its module on first use (PEP 562) and keep it."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List what is public, imported yet or not."""
    return sorted({*globals(), *__all__})
