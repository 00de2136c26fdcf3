"""Convert scenes to and from the contents of a scene file, a JSON object with a schema and a version.

{"schema": "iphyre_jax/scene", "version": 1, "name": "support",
 "block": [[[200, 400], [300, 400]], [[200, 500], [300, 500]]],   end points of each bar, px, y down
 "ball": [[250, 340, 20]],                                        x, y and radius of each ball, px
 "eli": [1, 1, 0],                                                can be removed: a flag for each block, then ball
 "dynamic": [0, 0, 1],                                            moves: a flag for each block, then ball
 "joint": [], "spring": [],                                       optional; pairs of object indices, blocks first
 "limits": {"objects": 20, "blocks": 10}}                         optional; for more than 12 objects or 6 eliminable
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from difflib import get_close_matches
from typing import Final

from iphyre_jax.checks import one_line, show
from iphyre_jax.scenes.errors import raise_problems
from iphyre_jax.scenes.limits import OFFICIAL, Limits, check_limits
from iphyre_jax.scenes.parse import OPTIONAL, REQUIRED
from iphyre_jax.scenes.scene import Scene, check_is_scene
from iphyre_jax.scenes.validate import check_scene

SCENE_SCHEMA: Final = "iphyre_jax/scene"
SCENE_VERSION: Final = 1

_FIELDS: Final = ("schema", "version", "name", *REQUIRED, *OPTIONAL, "limits")


def scene_from_dict(data: object, source: str = "scene", limits: Limits | None = None) -> Scene:
    """Build a scene from the contents of a scene file.

    Args:
        data: the parsed JSON object; the docstring of this module shows its fields.
        source: the file or argument that error messages name.
        limits: of the scene; they replace those in the contents.

    Returns:
        The scene.

    Raises:
        ValueError: fields are wrong; one line for each, "source: field: expected ..., got ...".
    """
    fields = check_object(data, source, SCENE_SCHEMA, SCENE_VERSION, _FIELDS)
    return scene_from_fields(fields, source, limits)


def scene_from_fields(fields: Mapping[str, object], source: str, limits: Limits | None = None) -> Scene:
    """Build a scene from its name and geometry, without schema and version.

    Args:
        fields: `name`, `block`, `ball`, `eli`, `dynamic` and optionally `joint`, `spring` and `limits`.
        source: the file or argument that error messages name.
        limits: of the scene; they replace those in the contents.

    Returns:
        The scene.

    Raises:
        ValueError: fields are wrong; one line for each.
    """
    if limits is not None:
        check_limits(limits)
    return Scene(**vars(check_scene(fields, source, limits=limits)))


def scene_to_dict(scene: Scene) -> dict[str, object]:
    """Return a scene as the contents of a scene file: plain numbers and lists. `scene_from_dict` reads them back.

    Args:
        scene: any scene.

    Returns:
        All fields of a scene file in order; `limits` only if they are not the official ones.

    Raises:
        ValueError: it is no Scene; one line.
    """
    check_is_scene("scene", scene)
    limits = {} if scene.limits == OFFICIAL else {"limits": asdict(scene.limits)}
    return {
        "schema": SCENE_SCHEMA,
        "version": SCENE_VERSION,
        "name": scene.name,
        "block": scene.blocks.tolist(),
        "ball": scene.balls.tolist(),
        "eli": scene.eliminable.astype(int).tolist(),
        "dynamic": scene.dynamic.astype(int).tolist(),
        "joint": [list(pair) for pair in scene.joints],
        "spring": [list(pair) for pair in scene.springs],
        **limits,
    }


def check_object(data: object, source: str, schema: str, version: int, fields: Iterable[str]) -> Mapping[str, object]:
    """Check that the contents of a file are an object with the right schema and version and no unknown fields.

    Args:
        data: the parsed JSON value.
        source: the file or argument that error messages name.
        schema: the expected schema.
        version: the expected version.
        fields: all allowed fields.

    Returns:
        The data.

    Raises:
        ValueError: one line for each wrong field.
    """
    known = tuple(fields)
    if not isinstance(data, Mapping):
        raise ValueError(f"{one_line(source)}: expected an object with the fields {', '.join(known)}, got {show(data)}")
    problems = []
    if data.get("schema") != schema:
        problems.append(f"schema: expected {schema!r}, got {show(data.get('schema'))}")
    elif type(data.get("version")) is not int or data["version"] != version:
        problems.append(f"version: expected {version}, got {show(data.get('version'))}")
    else:
        problems.extend(_unknown_field(key, known) for key in data if key not in known)
    raise_problems(source, problems)
    return data


def _unknown_field(key: object, known: tuple[str, ...]) -> str:
    """Describe an unknown field and suggest the most similar known one."""
    close = get_close_matches(str(key)[:100], known, n=1)
    hint = f" (did you mean {close[0]}?)" if close else f" (known are {', '.join(known)})"
    return f"{show(key)}: expected no such field{hint}"
