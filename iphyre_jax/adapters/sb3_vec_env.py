"""Gymnasium's vector environments as a `VecEnv` of Stable-Baselines3, which knows those of its own only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv

from iphyre_jax.checks import check_instance, show

Indices = int | Iterable[int] | None


class SB3VecEnv(VecEnv):
    """A vector environment of gymnasium for the trainers of Stable-Baselines3: all worlds play in one call.

    Its infos are a list of dicts, one for each world, as the library has them. When an episode ends they are those of
    its end, with "terminal_observation" and "TimeLimit.truncated"; those of the next one are in `reset_infos`. Wrap it
    in the library's `VecMonitor` to log returns.

    Args:
        envs: such as `GymnasiumVectorEnv`, perhaps in gymnasium's own vector wrappers; it begins the next episode
            within the step.

    Raises:
        ValueError: it is no vector environment, or resets in another way; one line.
    """

    def __init__(self, envs: VectorEnv) -> None:
        self.envs = check_instance("envs", envs, VectorEnv, "a vector environment of gymnasium")
        mode = (envs.metadata or {}).get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"envs: expected the autoreset_mode SameStep, got {show(getattr(mode, 'value', mode))}")
        self._actions: Any = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:  # noqa: ANN401 - arrays, or trees of them
        """Begin an episode in every world, with the seeds and options of `seed` and `set_options`."""
        seeded = any(seed is not None for seed in self._seeds)
        obs, infos = self.envs.reset(seed=self._seeds if seeded else None, options=self._options[0] or None)
        self.reset_infos = _each(infos, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Play the step: observations, rewards, whether episodes are done, and infos."""
        obs, rewards, terminated, truncated, arrays = self.envs.step(self._actions)
        done = terminated | truncated
        ends, last = arrays.pop("final_info", {}), arrays.pop("final_obs", None)
        infos, final = _each(arrays, self.num_envs), _each(ends, self.num_envs)
        for k in np.flatnonzero(done).tolist():
            self.reset_infos[k] = infos[k]
            cut = bool(truncated[k] and not terminated[k])
            infos[k] = final[k] | {"terminal_observation": last[k], "TimeLimit.truncated": cut}
        return obs, np.asarray(rewards, np.float32), done, infos

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each world."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: object, indices: Indices = None) -> None:
        """Refuse: the worlds share all attributes.

        Raises:
            NotImplementedError: always; one line.
        """
        raise NotImplementedError(f"set_attr: expected no attribute of single worlds, got {show(attr_name)}")

    def env_method(self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any) -> Any:  # noqa: ANN401
        """Call a method of the vector environment once; its result is there for each world."""
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: object, indices: Indices = None) -> list[bool]:
        """Return that no world is in a wrapper of single environments."""
        del wrapper_class
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Return the pictures of the worlds."""
        images: Any = self.envs.render()
        return [None] * self.num_envs if images is None else list(images)


def _each(infos: dict[str, Any], worlds: int) -> list[dict[str, Any]]:
    """Return infos as one dict for each world, of what that world has."""
    names = [name for name in infos if not name.startswith("_") and np.shape(infos[name])[:1] == (worlds,)]
    every = np.ones(worlds, bool)
    columns = [(name, infos[name].tolist(), infos.get(f"_{name}", every)) for name in names]
    if not columns:
        return [{} for _ in range(worlds)]
    if all(present.all() for *_, present in columns):
        return [dict(zip(names, row, strict=True)) for row in zip(*(values for _, values, _ in columns), strict=True)]
    return [{name: values[k] for name, values, present in columns if present[k]} for k in range(worlds)]
