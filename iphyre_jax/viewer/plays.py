"""Files of plays: JSON lines, each with a scene, a plan and its result. Every line can be replayed.

A damaged line (no JSON object: half a line of a process that was killed, bytes that a disk has lost) is skipped with a
warning. A line that is whole but wrong is refused, because somebody meant it.

{"schema": "iphyre_jax/play", "version": 1, "agent": "you", "scene": "hole",     a game, or the contents of a scene file
 "plan": [-1, -1, 83, 32],       the step before which each eliminable block is removed, -1 for never
 "fps": 60, "dtype": "float64", "resets": 1,
 "result": {"solved": true, "steps": 261, "eliminations": 2, "reward": 975.65},
 "facts": {...}}                 versions, time, number of the attempt: information for people, ignored here
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from iphyre_jax.checks import one_line, show, whole_fps
from iphyre_jax.files import check_writable, parse_json
from iphyre_jax.scenes import Scene, load_scene, scene_from_dict, scene_to_dict
from iphyre_jax.scenes.codec import check_object
from iphyre_jax.scenes.errors import raise_problems
from iphyre_jax.scenes.library import ALL_GAMES, is_game
from iphyre_jax.scenes.limits import MAX_NAME
from iphyre_jax.viewer import line_files
from iphyre_jax.viewer.recording import Recording, record, record_program

SCHEMA: Final = "iphyre_jax/play"
VERSION: Final = 1
FIELDS: Final = ("schema", "version", "agent", "scene", "plan", "fps", "dtype", "resets", "result", "facts")
RESULT_FIELDS: Final = ("solved", "steps", "eliminations", "reward")
MAX_LINE: Final = 100_000  # bytes of one play; a scene takes about 1 kB
MAX_FPS: Final = 1000
DTYPES: Final = ("float64", "float32")

_BEGIN: Final = b'{"schema": "iphyre_jax/play"'  # of each line that `append_play` writes


@dataclass(frozen=True)
class Play:
    """One line of a file of plays."""

    agent: str
    scene: Scene
    plan: tuple[int, ...]
    fps: int = 60
    dtype: str = "float64"
    resets: int = 1
    result: Mapping[str, object] | None = None
    """The result when the line was written."""

    def record(self) -> Recording:
        """Replay it."""
        return record(self.scene, list(self.plan), fps=self.fps, dtype=self.dtype, resets=self.resets)

    def difference(self, recording: Recording) -> str:
        """Describe how a recording differs from the stored result; empty if it does not, or if no result is stored."""
        now, then = result_of(recording), self.result or {}
        return "; ".join(f"{key} {show(value)}, now {now[key]}" for key, value in then.items() if value != now[key])


def result_of(recording: Recording) -> dict[str, object]:
    """Return the field `result` of a line for a recording."""
    return {
        "solved": recording.success,
        "steps": recording.steps,
        "eliminations": recording.eliminations,
        "reward": recording.reward,
    }


def play_to_json(recording: Recording, agent: str, facts: Mapping[str, object]) -> dict[str, object]:
    """Return the contents of a line for a recording."""
    scene = recording.scene
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "agent": agent,
        "scene": scene.name if is_game(scene) else scene_to_dict(scene),
        "plan": list(recording.plan),
        "fps": recording.fps,
        "dtype": recording.dtype,
        "resets": recording.resets,
        "result": result_of(recording),
        "facts": dict(facts),
    }


def append_play(path: Path, line: Mapping[str, object]) -> None:
    """Add a line to a file of plays. It is on disk when this function returns; after an error nothing was added.

    Raises:
        OSError: the file cannot be written.
        ValueError: the line has more than MAX_LINE bytes.
    """
    content = json.dumps(line, allow_nan=False).encode()
    line_files.append_line(path, content, _BEGIN, _is_object, MAX_LINE)


def open_plays(path: Path) -> None:
    """Make ready a file of plays to which attempts will be added: a torn last line is cut, with a warning.

    A file that is missing stays missing.

    Raises:
        OSError: it cannot be read or written.
        ValueError: it is no file, or holds something else than plays; one line.
    """
    name = one_line(str(path))
    if not path.exists():
        check_writable(path.parent, name)
        return
    if not path.is_file():
        raise ValueError(f"{name}: expected a file of plays, got something that is no file")
    lines = (content for _, content in line_files.read_lines(path, MAX_LINE))
    if not holds_plays(path) and any(content is None or content.strip() for content in lines):
        raise ValueError(f"{name}: expected a file of plays, got something else; attempts are not added to it")
    line_files.mend_file(path, _BEGIN, _is_object, MAX_LINE)


def holds_plays(path: Path) -> bool:
    """Return whether a line of a file is meant as a play, right, wrong or torn; OSError if it cannot be read."""
    lines = (content for _, content in line_files.read_lines(path, MAX_LINE))
    return any(
        content is not None and (_BEGIN.startswith(content) or content.startswith(_BEGIN) or _is_play(content))
        for content in lines
    )


def read_plays(path: str | os.PathLike[str]) -> list[Play]:
    """Read a file of plays of any length; `iter_plays` takes less memory.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: it cannot be read.
        ValueError: a line is wrong; the message names file, line and field.
    """
    return list(iter_plays(path))


def iter_plays(path: str | os.PathLike[str], *, required: bool = False) -> Iterator[Play]:
    """Yield the plays of a file, one line in memory at a time; errors are those of `read_plays`.

    Damaged lines are skipped, with one warning at the end. If all lines are damaged, the file is something else.

    Args:
        path: the file.
        required: whether a file without a play is an error too, also if that is because its only line is torn.
    """
    name = one_line(str(path))
    if not Path(path).is_file():
        raise FileNotFoundError(f"{name}: expected a file of plays, but there is none")
    read, damaged = 0, line_files.Damage()
    for number, content in line_files.read_lines(Path(path), MAX_LINE):
        source = f"{name}: line {number}"
        if content is not None and not content.strip():
            continue
        try:
            fields = _parse_line(content, source)
        except ValueError as error:
            is_torn = content is not None and not content.endswith(b"\n") and content.startswith(_BEGIN[: len(content)])
            damaged.add(number, None if is_torn else error)
            continue
        yield play_from_json(fields, source)
        read += 1
    if damaged.first is not None and not read:
        raise damaged.first
    if required and not read:
        why = f"; {damaged.describe()}" if damaged.count else ""
        raise ValueError(f"{name}: expected at least one play, got none{why}")
    if damaged.count:
        warnings.warn(f"{name}: {damaged.describe()}", RuntimeWarning, stacklevel=2)


def _parse_line(content: bytes | None, source: str) -> Mapping[str, object]:
    """Return the object in a line.

    Earlier versions glued an attempt to the half line before it; such an attempt is found there.

    Raises:
        ValueError: the line is damaged; one line.
    """
    if content is None:
        raise ValueError(f"{source}: expected at most {MAX_LINE} bytes, got more")
    try:
        fields = parse_json(content, source)
    except ValueError:
        glued = content.rfind(_BEGIN)  # it cannot stand inside a text, where quotes are escaped
        if glued <= 0:
            raise
        fields = parse_json(content[glued:], source)
    if not isinstance(fields, Mapping):
        raise ValueError(f"{source}: expected an object with the fields {', '.join(FIELDS)}, got {show(fields)}")
    return fields


def _is_object(content: bytes) -> bool:
    try:
        return isinstance(parse_json(content, ""), Mapping)
    except ValueError:
        return False


def _is_play(content: bytes) -> bool:
    """Return whether a line is meant as a play, right or wrong."""
    try:
        return _parse_line(content, "").get("schema") == SCHEMA
    except ValueError:
        return False


def play_from_json(data: object, source: str) -> Play:
    """Read the contents of one line.

    Raises:
        ValueError: a field is wrong; one line for each, "source: field: expected ..., got ...".
    """
    fields = check_object(data, source, SCHEMA, VERSION, FIELDS)
    scene = read_scene_field(fields.get("scene"), source)
    problems = []
    agent = fields.get("agent")
    if not is_name(agent):
        problems.append(f"agent: expected a text of 1 to {MAX_NAME} printable characters, got {show(agent)}")
    plan = fields.get("plan")
    problems.extend(plan_problems(plan, scene))
    fps, dtype, resets = fields.get("fps", 60), fields.get("dtype", "float64"), fields.get("resets", 1)
    try:
        if whole_fps(fps) > MAX_FPS:
            problems.append(f"fps: expected at most {MAX_FPS}, got {show(fps)}")
    except ValueError:
        problems.append(f"fps: expected a positive whole number, got {show(fps)}")
    if dtype not in DTYPES:
        problems.append(f"dtype: expected one of {', '.join(DTYPES)}, got {show(dtype)}")
    if type(resets) is not int or not 1 <= resets <= 1000:
        problems.append(f"resets: expected a whole number from 1 to 1000, got {show(resets)}")
    result = fields.get("result")
    if result is not None and (not isinstance(result, Mapping) or set(result) != set(RESULT_FIELDS)):
        problems.append(f"result: expected an object of {', '.join(RESULT_FIELDS)}, got {show(result)}")
    raise_problems(source, problems)
    try:
        record_program(scene, fps=int(fps), dtype=str(dtype))  # type: ignore[call-overload]  # checked above
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    return Play(str(agent), scene, tuple(plan), int(fps), dtype, resets, result)  # type: ignore[arg-type, call-overload]  # checked above


def is_name(value: object) -> bool:
    """Return whether a value can name an agent. Names are shown in terminals, so control characters are not allowed."""
    return isinstance(value, str) and 0 < len(value) <= MAX_NAME and value.isprintable() and value == value.strip()


def read_scene_field(value: object, source: str) -> Scene:
    """Return the scene for the name of a game or the contents of a scene file; paths are not allowed.

    Raises:
        ValueError: it is neither; one line for each wrong field.
    """
    if isinstance(value, str):
        if value not in ALL_GAMES:
            raise ValueError(f"{source}: scene: expected the name of a game or a scene, got {show(value)}")
        return load_scene(value)
    return scene_from_dict(value, f"{source}: scene")


def plan_problems(plan: object, scene: Scene) -> Sequence[str]:
    """List what is wrong with a plan: it needs one step for each eliminable block."""
    blocks = len(scene.eliminable_blocks)
    if not isinstance(plan, list) or len(plan) != blocks:
        return [f"plan: expected {blocks} steps, one for each eliminable block, got {show(plan)}"]
    wrong = [k for k, step in enumerate(plan) if type(step) is not int or not -1 <= step < 2**31]
    return [f"plan[{k}]: expected a step from 0 on, or -1 for never, got {show(plan[k])}" for k in wrong]
