"""The JSON Schema of a scene file, made from the limits that the reader enforces."""

from __future__ import annotations

from typing import Any, Final

from iphyre_jax.scenes.convert import SCENE_SCHEMA, SCENE_VERSION
from iphyre_jax.scenes.limits import MAX_COORDINATE, MAX_ELIMINABLE, MAX_NAME, MAX_OBJECTS, MIN_LENGTH

DRAFT: Final = "https://json-schema.org/draft/2020-12/schema"


def scene_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scene file.

    It says all that a schema can say of a file; `read_scene` also sees to what depends on several fields: as many flags
    as objects, at most 6 eliminable blocks, pairs of different objects of which one moves, no pair twice, lengths.
    """
    number = {"type": "number", "minimum": -MAX_COORDINATE, "maximum": MAX_COORDINATE}
    point = _tuple([number, number], "x, y in px; y points down")
    radius = {"type": "number", "minimum": MIN_LENGTH, "maximum": MAX_COORDINATE}
    flag = {"enum": [0, 1]}
    index = {"type": "integer", "minimum": 0, "maximum": MAX_OBJECTS - 1}
    pairs = {
        "type": "array",
        "items": _tuple([index, index], "two objects: blocks counted first, then balls, from 0"),
        "maxItems": MAX_OBJECTS * (MAX_OBJECTS - 1) // 2,
        "uniqueItems": True,
    }
    return {
        "$schema": DRAFT,
        "title": "I-PHYRE scene",
        "type": "object",
        "required": ["schema", "version", "name", "block", "ball", "eli", "dynamic"],
        "additionalProperties": False,
        "properties": {
            "schema": {"const": SCENE_SCHEMA},
            "version": {"const": SCENE_VERSION},
            "name": {"type": "string", "minLength": 1, "maxLength": MAX_NAME},
            "block": {
                "description": "Bars with a radius of 10 px, by the ends of their axes.",
                "type": "array",
                "items": _tuple([point, point], "a bar from one point to another"),
                "maxItems": MAX_OBJECTS - 1,
            },
            "ball": {
                "description": "Balls, which always move and must all fall below y = 600.",
                "type": "array",
                "items": _tuple([number, number, radius], "x, y and radius in px"),
                "minItems": 1,
                "maxItems": MAX_OBJECTS,
            },
            "eli": {
                "description": f"One flag an object: can be removed; static blocks only, at most {MAX_ELIMINABLE}.",
                "type": "array",
                "items": flag,
                "minItems": 1,
                "maxItems": MAX_OBJECTS,
            },
            "dynamic": {
                "description": "One flag an object: moves; 1 for every ball.",
                "type": "array",
                "items": flag,
                "minItems": 1,
                "maxItems": MAX_OBJECTS,
            },
            "joint": {"description": "Pin joints from centre to centre.", **pairs},
            "spring": {"description": "Damped springs from centre to centre, rest length 20 px.", **pairs},
        },
    }


def _tuple(items: list[Any], description: str) -> dict[str, Any]:
    return {
        "description": description,
        "type": "array",
        "prefixItems": items,
        "minItems": len(items),
        "maxItems": len(items),
        "items": False,
    }
