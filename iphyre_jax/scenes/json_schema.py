"""The JSON Schema of a scene file, made from the limits that the reader enforces."""

from __future__ import annotations

from typing import Any, Final

from iphyre_jax.scenes.codec import SCENE_SCHEMA, SCENE_VERSION
from iphyre_jax.scenes.limits import (
    MAX_COORDINATE,
    MAX_ELIMINABLE,
    MAX_MOVING,
    MAX_NAME,
    MAX_OBJECTS,
    MIN_LENGTH,
    MOST_OBJECTS,
)

DRAFT: Final = "https://json-schema.org/draft/2020-12/schema"


def scene_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scene file.

    It says all that a schema can say of a file; `read_scene` also sees to what depends on several fields: as many flags
    as objects, as many objects and eliminable blocks as the file's limits allow, pairs of different objects of which
    one moves, no pair twice, lengths.
    """
    number = {"type": "number", "minimum": -MAX_COORDINATE, "maximum": MAX_COORDINATE}
    point = _fixed_array([number, number], "x, y in px; y points down")
    radius = {"type": "number", "minimum": MIN_LENGTH, "maximum": MAX_COORDINATE}
    flags = {"type": "array", "items": {"enum": [0, 1]}, "minItems": 1}
    fields: dict[str, Any] = {
        "schema": {"const": SCENE_SCHEMA},
        "version": {"const": SCENE_VERSION},
        "name": {"type": "string", "minLength": 1, "maxLength": MAX_NAME},
        "block": {
            "description": "Bars with a radius of 10 px, by the ends of their axes.",
            "type": "array",
            "items": _fixed_array([point, point], "a bar from one point to another"),
        },
        "ball": {
            "description": "Balls, which always move and must all fall below y = 600.",
            "type": "array",
            "items": _fixed_array([number, number, radius], "x, y and radius in px"),
            "minItems": 1,
        },
        "eli": {
            "description": f"One flag an object: can be removed; static blocks only, {MAX_ELIMINABLE} without limits.",
            **flags,
        },
        "dynamic": {"description": f"One flag an object: moves; 1 for every ball, at most {MAX_MOVING}.", **flags},
        "joint": {"description": "Pin joints from centre to centre.", "type": "array", "uniqueItems": True},
        "spring": {
            "description": "Damped springs from centre to centre, rest length 20 px.",
            "type": "array",
            "uniqueItems": True,
        },
        "limits": {
            "description": "How many objects and eliminable blocks the scene may have: rows and slots for agents.",
            "type": "object",
            "required": [],
            "additionalProperties": False,
            "properties": {
                "objects": {"type": "integer", "minimum": MAX_OBJECTS, "maximum": MOST_OBJECTS},
                "blocks": {"type": "integer", "minimum": MAX_ELIMINABLE, "maximum": MOST_OBJECTS},
            },
        },
    }
    most = _size_bounds(MOST_OBJECTS)
    return {
        "$schema": DRAFT,
        "title": "I-PHYRE scene",
        "type": "object",
        "required": ["schema", "version", "name", "block", "ball", "eli", "dynamic"],
        "additionalProperties": False,
        "properties": {key: field | most.get(key, {}) for key, field in fields.items()},
        "if": {"not": {"required": ["limits"]}},
        "then": {"properties": _size_bounds(MAX_OBJECTS)},
    }


def _size_bounds(objects: int) -> dict[str, Any]:
    """Return what the greatest number of objects says of the fields."""
    index = {"type": "integer", "minimum": 0, "maximum": objects - 1}
    pairs = {
        "items": _fixed_array([index, index], "two objects: blocks counted first, then balls, from 0"),
        "maxItems": objects * (objects - 1) // 2,
    }
    lists = {"block": objects - 1, "ball": objects, "eli": objects, "dynamic": objects}
    return {key: {"maxItems": most} for key, most in lists.items()} | {"joint": pairs, "spring": pairs}


def _fixed_array(items: list[Any], description: str) -> dict[str, Any]:
    return {
        "description": description,
        "type": "array",
        "prefixItems": items,
        "minItems": len(items),
        "maxItems": len(items),
        "items": False,
    }
