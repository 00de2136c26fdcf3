"""Names that settings and learner states had before version 3 of run folders, with their present ones.

Files of the older versions are read through these tables. Options of the command line keep working for one version.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

SETTINGS: Final = MappingProxyType(
    {
        "centred": "center_obs",
        "hidden": "hidden_sizes",
        # of the learner
        "actor_rate": "actor_lr",
        "anneal": "anneal_lr",
        "batch": "batch_size",
        "clip": "clip_eps",
        "discount": "gamma",
        "entropy": "ent_coef",
        "epsilon_rounds": "epsilon_updates",
        "idle": "no_op_prob",
        "kl_weight": "kl_coef",
        "noise_rounds": "noise_updates",
        "normalise": "normalize_advantage",
        "random_rounds": "random_updates",
        "replay": "buffer_size",
        "rows": "samples_per_update",
        "steps": "gradient_steps",
        "target_rate": "tau",
        "trace": "gae_lambda",
        "value_weight": "vf_coef",
    }
)
VALUES: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "head": {"slots": "time_grid", "squashed": "tanh_normal", "point": "deterministic", "even": "uniform"},
        "network": {"perceptron": "mlp"},
    }
)
_QUICK: Final = MappingProxyType({"agent": "ppo", "strategy": "in-advance", "preset": "default"})
# Parts of the path to an array of the state, "learner.learned.buffer.kept.choice".
STATE: Final = MappingProxyType(
    {
        "choice": "raw_action",
        "filled": "size",
        "following": "next_obs",
        "kept": "transitions",
        "kl_weight": "kl_coef",
        "learned": "train_state",
        "made": "num_updates",
        "next": "position",
        "observation": "obs",
        "optimiser": "opt_state",
        "policy_optimiser": "policy_opt_state",
        "value_optimiser": "value_opt_state",
    }
)


def settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with present names and values, those of the learner too."""
    found = {SETTINGS.get(name, name): _value(name, value) for name, value in values.items()}
    if tuple(map(found.get, _QUICK)) == tuple(_QUICK.values()):  # "quick" was called "default"
        found["preset"] = "quick"
    return found


def _value(name: str, value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if name == "learner" and isinstance(value, dict):
        return settings(value)
    return VALUES[name].get(value, value) if name in VALUES and isinstance(value, str) else value


def array_path(path: str) -> str:
    """The present path of an array of the state."""
    return ".".join(STATE.get(part, part) for part in path.split("."))


def options(arguments: Sequence[str]) -> list[str]:
    """Arguments of the command line with present names."""
    renamed = [_option(argument) for argument in arguments]
    for k in range(1, len(renamed)):
        renamed[k] = VALUES.get(renamed[k - 1].removeprefix("--"), {}).get(renamed[k], renamed[k])
    return renamed


def _option(argument: str) -> str:
    """One argument with its present name: --hidden, --no-anneal, --head=slots."""
    option, equals, value = argument.partition("=")
    prefix = "--no-" if option.startswith("--no-") else "--"
    name = option.removeprefix(prefix).replace("-", "_")
    if not argument.startswith("--") or (name not in SETTINGS and name not in VALUES):
        return argument
    value = VALUES.get(name, {}).get(value, value)
    return prefix + SETTINGS.get(name, name).replace("_", "-") + equals + value
