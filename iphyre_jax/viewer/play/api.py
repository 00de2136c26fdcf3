"""The calls of the play page. Every answer is computed from the scene and plan that the page sends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import iphyre_jax
from iphyre_jax.checks import show
from iphyre_jax.files import parse_json
from iphyre_jax.paper import paper_numbers, paper_rewards
from iphyre_jax.rules import NEVER, PEOPLE_FPS, TIME_LIMIT
from iphyre_jax.scenes import SPLITS, Scene, scene_from_dict, scene_to_dict
from iphyre_jax.scenes.errors import raise_problems
from iphyre_jax.scenes.geometry import scene_warnings
from iphyre_jax.scenes.library import is_game
from iphyre_jax.viewer import themes
from iphyre_jax.viewer.load_plays import best_plays
from iphyre_jax.viewer.pack import pack_play
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.session import ATTEMPTS, Session
from iphyre_jax.viewer.play.simulator import Simulator, shared_simulator
from iphyre_jax.viewer.plays import Play, plan_problems, read_scene_field
from iphyre_jax.viewer.recording import Recording

MOST_TIED: Final = 100  # moving objects x ties; 96 compiled in 26 s on a busy machine, 200 not in 90 s of a core
MOST_MOVING: Final = 9  # moving objects; ten untied ones compiled in 82 s on a busy machine

Fields = Mapping[str, Any]


class Api:
    """Answers the calls of the page.

    Args:
        session: counts and saves attempts.
        agents: plays to compare with, besides the best known plans.
        scenes: scenes to play, besides the forty games.
        simulator: plays; by default the one that all servers of this process share.
    """

    def __init__(
        self,
        session: Session,
        agents: Sequence[Play] = (),
        scenes: Sequence[Scene] = (),
        simulator: Simulator | None = None,
    ) -> None:
        self._session, self._scenes = session, tuple(scenes)
        self.simulator = simulator or shared_simulator()
        self._agents = [*best_plays().values(), *agents]
        self._calls: dict[str, tuple[Callable[[Fields], object], frozenset[str]]] = {
            "api/start": (self._start, frozenset()),
            "api/game": (self._game, frozenset({"scene"})),
            "api/record": (self._play_on, frozenset({"scene", "plan"})),
            "api/attempt": (self._attempt, frozenset({"scene", "plan"})),
            "api/again": (self._again, frozenset({"scene"})),
            "api/agents": (self._agents_and_attempts, frozenset({"scene"})),
            "api/check": (self._check, frozenset({"scene"})),
        }

    def call(self, name: str, body: bytes) -> object:
        """Answer a call.

        Args:
            name: the name of the call.
            body: its arguments, a JSON object.

        Raises:
            RefusedError: there is no such call, or it is not possible now.
            ValueError: the arguments are wrong; one line for each.
        """
        if name not in self._calls:
            raise RefusedError(404, "no such call")
        handler, expected = self._calls[name]
        fields = parse_json(body, "request")
        if not isinstance(fields, Mapping) or set(fields) != expected:
            names = ", ".join(sorted(expected)) or "no fields"
            raise ValueError(f"request: expected an object with {names}, got {show(fields)}")
        return handler(fields)

    def _start(self, fields: Fields) -> object:
        """Return what the page shows before a game is chosen."""
        own = [{"split": "own scenes", "name": scene.name, "scene": scene_to_dict(scene)} for scene in self._scenes]
        games = [{"split": split, "name": game, "scene": game} for split in SPLITS for game in SPLITS[split]]
        return {
            "version": iphyre_jax.__version__,
            "themes": themes.as_json(),
            "games": games + own,
            "attempts": ATTEMPTS,
            "seconds": TIME_LIMIT,
            "fps": PEOPLE_FPS,
            "source": {name: paper_numbers()[name] for name in ("source", "protocol")},
        }

    def _game(self, fields: Fields) -> object:
        """Return a scene, its play without removals, the scores in the paper, and the attempts so far."""
        scene = _read_scene(fields)
        untouched = self._record(_own_play(scene, [NEVER] * len(scene.eliminable_blocks)))
        own = is_game(scene)
        best = best_plays().get(scene.name) if own else None
        return {
            "scene": scene_to_dict(scene),
            "play": pack_play(untouched),
            "figures": paper_rewards(scene.name) if own else {},
            "best": dict(best.result or {}) if best else None,
            "standing": self._session.standing(scene),
        }

    def _play_on(self, fields: Fields) -> object:
        """Return the play of a plan that the person may still change."""
        scene = _read_scene(fields)
        return pack_play(self._record(_own_play(scene, _read_plan(fields, scene))))

    def _attempt(self, fields: Fields) -> object:
        """Count, save and score an attempt; the server computes the score from the plan."""
        scene = _read_scene(fields)
        recording = self._record(_own_play(scene, _read_plan(fields, scene)))
        standing = self._session.add(recording)
        return {"play": pack_play(recording), "standing": standing}

    def _again(self, fields: Fields) -> object:
        return {"standing": self._session.begin_again(_read_scene(fields))}

    def _agents_and_attempts(self, fields: Fields) -> object:
        """Return plays of a scene by others, and the attempts of the person; a line for each reason why some fail."""
        scene = _read_scene(fields)
        others = [(play, False) for play in self._agents if play.scene == scene]
        own = [(play, True) for play in self._session.attempts(scene)]
        plays: list[dict[str, object]] = []
        failed: dict[str, set[str]] = {}  # why -> whose plays
        refused: dict[tuple[int, str], str] = {}  # such a program is asked for once: it may take a minute
        for play, mine in others + own:
            why = refused.get((play.fps, play.dtype))
            try:
                if why is None:
                    plays.append({"agent": play.agent, "own": mine, **pack_play(self._record(play))})
            except RefusedError as error:
                why = refused[play.fps, play.dtype] = str(error)
            except ValueError as error:
                why = str(error)
            if why is not None:
                failed.setdefault(why, set()).add(play.agent)
        return {"plays": plays, "failed": [f"not shown: {_listed(names)}: {why}" for why, names in failed.items()]}

    def _check(self, fields: Fields) -> object:
        """Return what is wrong with a scene, and what is unusual if nothing is wrong."""
        try:
            scene = scene_from_dict(fields["scene"], "")
        except ValueError as error:
            lines = [line.removeprefix(": ") for line in str(error).split("\n")]
            return {"problems": lines, "warnings": []}
        return {"problems": [], "warnings": [*scene_warnings(scene), *_size_warnings(scene)]}

    def _record(self, play: Play) -> Recording:
        return self.simulator.record(play, is_game=is_game(play.scene))


def _size_warnings(scene: Scene) -> list[str]:
    """Say whether the simulator may refuse a scene, whose preparation is ended after a while."""
    moving, ties = int(scene.dynamic.sum()), len(scene.joints) + len(scene.springs)
    if moving * ties <= MOST_TIED and moving <= MOST_MOVING:
        return []
    counts = f"{ties} joints and springs, {moving} moving objects"
    return [f"{counts}: preparing this scene takes minutes, and may take too long to be played here"]


def _listed(agents: Iterable[str], most: int = 5) -> str:
    names = sorted(agents)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _own_play(scene: Scene, plan: Sequence[int]) -> Play:
    return Play("you", scene, tuple(plan), PEOPLE_FPS)


def _read_scene(fields: Fields) -> Scene:
    return read_scene_field(fields["scene"], "request")


def _read_plan(fields: Fields, scene: Scene) -> list[int]:
    """Return the plan of a person: at most one removal per step, none before step 1, as in the official simulator."""
    plan = fields["plan"]
    raise_problems("request", plan_problems(plan, scene))
    steps = [step for step in plan if step != NEVER]
    if any(not 0 < step < TIME_LIMIT * PEOPLE_FPS for step in steps) or len(set(steps)) != len(steps):
        raise ValueError(
            f"request: plan: expected different steps from 1 to {int(TIME_LIMIT * PEOPLE_FPS) - 1}, got {steps}"
        )
    return list(plan)
