"""The official simulator class: one game, clicks by position, Python numbers."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any, NoReturn

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_flag, check_fps, is_list, show
from iphyre_jax.compat import data
from iphyre_jax.compat.games import scene_of
from iphyre_jax.compat.objects import Objects, position_of
from iphyre_jax.compat.picture import SIZE, picture
from iphyre_jax.compat.world import SteppedWorld
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.plans import official_clock
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import Scene

Click = Sequence[float]  # x, y, t: px and s


class IPHYRE(Objects):
    """One game.

    The calls and their results are those of the official class; positions may be lists, tuples or arrays. As there,
    `reset` empties and refills one space, which changes the order of contacts from reset to reset.

    Attributes are the official ones, except those that hold pymunk's or pygame's objects: they raise an AttributeError
    that says so.

    Args:
        game: a game's name, also one that was added to `PARAS`, or, beyond the official class, a scene file or a Scene.
        fps: physics steps a second, 0.001 to 100,000.

    Raises:
        ValueError: no such game, or another rate; one line.
    """

    def __init__(self, game: str | os.PathLike[str] | Scene = "support", fps: float = 60) -> None:
        check_fps(fps)
        self.scene = scene_of(game)
        self.game = self.scene.name
        self.FPS = fps
        self.timestep = 1 / float(fps)
        self.max_time = int(TIME_LIMIT)
        self.max_obj_num, self.max_eli_obj_num = self.scene.limits.objects, self.scene.limits.blocks
        self.step_reward, self.eli_reward, self.success_reward = -self.timestep, -10, 1000
        self.blocks, self.balls = self.scene.blocks.tolist(), self.scene.balls.tolist()
        self.num_obj, self.num_ball = self.scene.n_objects, self.scene.n_balls
        self.HEIGHT, self.WIDTH, self.screen = SIZE, SIZE, None
        self._resets = 0
        self._world: SteppedWorld | None = None

    def reset(self, use_images: bool = False) -> npt.NDArray[Any]:
        """Start again; return the table or the picture, as `step` does."""
        check_fork()
        check_flag("use_images", use_images)
        self._resets += 1
        self._world = SteppedWorld(self.scene, float(self.FPS), self._resets)
        return self._observation(use_images)

    def step(
        self, pos: Sequence[float] | npt.NDArray[Any], use_images: bool = False
    ) -> tuple[npt.NDArray[Any], float, bool]:
        """Click, then play one physics step; also after success.

        Args:
            pos: x and y of the click, px; 0, 0 for none.
            use_images: whether to return the picture, (600, 600, 3) uint8 in blue, green, red, instead of the table.

        Returns:
            The table (see `get_all_property`) or picture, the reward (-1/fps, -10 for a removed block, 1000 if solved)
            and whether the game is solved.

        Raises:
            ValueError: pos is not a position, or `reset` was not called; one line.
        """
        check_flag("use_images", use_images)
        x, y = position_of(pos)
        hit = self._hit(x, y, self._started.alive) if (x, y) != (0.0, 0.0) else None
        if hit is not None:
            self._started.remove(hit)
        _, solved = self._started.run(1)
        reward = self.step_reward
        reward += self.eli_reward if hit is not None else 0
        reward += self.success_reward if solved else 0
        return self._observation(use_images), reward, solved

    def simulate(self, action: Sequence[Click] = ()) -> tuple[int, int, float]:
        """Play 15 s under timed clicks.

        Args:
            action: clicks (x, y, t), taken in order of time, at most one a step; one at t = 0 has no effect.

        Returns:
            1 if solved, else 0; the number of blocks removed; seconds played by the official clock.

        Raises:
            ValueError: action does not hold clicks, or `reset` was not called; one line.
        """
        frames = self.frames()
        present = int(self._started.alive.sum())
        made, solved = self.run_plan(self.removals(action), 0, len(frames))
        removed = present - int(self._started.alive.sum())
        return int(solved), removed, [*frames, frames[-1] + self.timestep][made]

    def get_action_space(self) -> list[list[float]]:
        """Reset and return the click positions: 0, 0 for none, the centres of the eliminable blocks, then 0, 0."""
        self.reset()
        centres = [self._started.features.position[block].tolist() for block in self.scene.eliminable_blocks]
        return [[0.0, 0.0], *centres, *([0.0, 0.0] for _ in range(self.max_eli_obj_num - len(centres)))]

    def get_all_property(self) -> npt.NDArray[np.float64]:
        """Return the current objects, (12, 9) float64: x1, y1, x2, y2, radius, eli, dynamic, joint, spring.

        Removed objects are rows of zeros; joint and spring are the number of the pair, from 1, or 0.
        """
        return self._started.table()

    def collect_initial_data(self, save_path: str = "./game_initial_data/", images: bool = True) -> None:
        """Save the start of the game; see `iphyre_jax.compat.data.save_start`."""
        data.save_start(self, save_path, images)

    def collect_seq_data(
        self,
        save_path: str = "./offline_data/",
        act_lists: Sequence[Sequence[Click]] = (),
        fps: int = 10,
        images: bool = True,
    ) -> None:
        """Save sequences of states under timed clicks; see `iphyre_jax.compat.data.save_sequences`."""
        data.save_sequences(self, save_path, act_lists, fps, images)

    def play(self) -> NoReturn:
        """Raise NotImplementedError: the official class opens a window; use `step` and `picture`."""
        raise no_window("play", "step and picture")

    def simulate_vis(self, action: Sequence[Click] = ()) -> NoReturn:
        """Raise NotImplementedError: the official class opens a window; use `collect_seq_data` for the pictures."""
        raise no_window("simulate_vis", "simulate for the result and collect_seq_data for its pictures")

    def collect_while_play(
        self, player_name: str = "", max_episode: int = 5, save_path: str = "./player_data.json"
    ) -> NoReturn:
        """Raise NotImplementedError: the official class opens a window; use `step`."""
        raise no_window("collect_while_play", "step, and save its actions and rewards")

    def picture(self) -> npt.NDArray[np.uint8]:
        """Return the picture of the world, (600, 600, 3) uint8 in red, green, blue."""
        with jax.enable_x64(True):
            return picture(self._started)

    def frames(self) -> list[float]:
        """Return the official clock at the start of each step of `simulate`, s: the sums of 1/fps below 15."""
        clock: list[float] = official_clock(float(self.FPS)).tolist()
        return clock

    def removals(self, action: Sequence[Click]) -> dict[int, int]:
        """Return the objects that timed clicks remove, each with its step from now."""
        if not is_list(action):
            raise ValueError(f"action: expected a sequence of clicks x, y, t, got {show(action)}")
        alive, found = self._started.alive.copy(), {}
        due = iter(sorted(map(_click, action), key=lambda click: click[2]))
        click = next(due, None)
        for step, now in enumerate(self.frames()):
            if click is None:
                break
            if now >= click[2]:
                hit = self._hit(click[0], click[1], alive) if click[2] != 0 else None
                if hit is not None:
                    alive[hit] = False
                    found[hit] = step
                click = next(due, None)
        return found

    def run_plan(self, removals: dict[int, int], since: int, until: int) -> tuple[int, bool]:
        """Play a plan from one step to another, or to the step that solves the game.

        Args:
            removals: object indices of blocks and the steps before which they go.
            since: steps of the plan made so far.
            until: steps to make in total; removals due before the next step happen too.

        Returns:
            Steps of the plan made, and whether the last of them solved the game.
        """
        for block, step in sorted(removals.items(), key=lambda removal: removal[1]):
            if since <= step <= until and self._started.alive[block]:
                made, solved = self._started.run(step - since)
                since += made
                if solved:
                    return since, True
                self._started.remove(block)
        made, solved = self._started.run(until - since)
        return since + made, solved

    def _observation(self, use_images: bool) -> npt.NDArray[Any]:
        return self.picture()[:, :, ::-1] if use_images else self.get_all_property()


def no_window(name: str, instead: str) -> NotImplementedError:
    """Return the error of a call that opens a window."""
    return NotImplementedError(f"{name}: expected a window, which iphyre_jax.compat does not open; use {instead}")


def _click(click: object) -> tuple[float, float, float]:
    """Return a timed click's x, y and t."""
    try:
        x, y, t = (float(part) for part in click)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"action: expected clicks x, y, t, got {show(click)}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"action: expected finite positions, got {x!r}, {y!r}")
    if not t >= 0:
        raise ValueError(f"action: expected times that are not negative, got {t!r}")
    return x, y, t
