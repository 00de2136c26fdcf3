"""The JSON Schema of scene files, built from the limits that the reader enforces."""

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

    `read_scene` also checks what a schema cannot express because it depends on several fields: one flag per object,
    the limits of the file, two different objects in each pair, at least one of which moves, no pair twice, and lengths.
    """
    fields = _field_schemas()
    size_bounds = _size_bounds(MOST_OBJECTS)
    return {
        "$schema": DRAFT,
        "title": "I-PHYRE scene",
        "type": "object",
        "required": ["schema", "version", "name", "block", "ball", "eli", "dynamic"],
        "additionalProperties": False,
        "properties": {key: field | size_bounds.get(key, {}) for key, field in fields.items()},
        "if": {"not": {"required": ["limits"]}},
        "then": {"properties": _size_bounds(MAX_OBJECTS)},
    }


def _field_schemas() -> dict[str, Any]:
    """Return the schema of each field, apart from numbers of entries."""
    number = {"type": "number", "minimum": -MAX_COORDINATE, "maximum": MAX_COORDINATE}
    radius = {"type": "number", "minimum": MIN_LENGTH, "maximum": MAX_COORDINATE}
    point = _fixed_array("x, y in px; y points down", number, number)
    bar = _fixed_array("a bar from one point to another", point, point)
    ball = _fixed_array("x, y and radius in px", number, number, radius)
    flags = {"items": {"enum": [0, 1]}, "minItems": 1}
    removable = f"One flag per object: 1 if the player can remove it. Static blocks only, {MAX_ELIMINABLE} by default."
    moving = f"One flag per object: 1 if it moves. 1 for every ball; at most {MAX_MOVING} in all."
    return {
        "schema": {"const": SCENE_SCHEMA},
        "version": {"const": SCENE_VERSION},
        "name": {"type": "string", "minLength": 1, "maxLength": MAX_NAME},
        "block": _array("Bars with a radius of 10 px, given by the ends of their axes.", items=bar),
        "ball": _array("Balls. They always move, and all must fall below y = 600.", items=ball, minItems=1),
        "eli": _array(removable, **flags),
        "dynamic": _array(moving, **flags),
        "joint": _array("Pin joints from centre to centre.", uniqueItems=True),
        "spring": _array("Damped springs from centre to centre, rest length 20 px.", uniqueItems=True),
        "limits": {
            "description": "Numbers of objects and eliminable blocks allowed: the size of observations and plans.",
            "type": "object",
            "required": [],
            "additionalProperties": False,
            "properties": {
                "objects": {"type": "integer", "minimum": MAX_OBJECTS, "maximum": MOST_OBJECTS},
                "blocks": {"type": "integer", "minimum": MAX_ELIMINABLE, "maximum": MOST_OBJECTS},
            },
        },
    }


def _size_bounds(objects: int) -> dict[str, Any]:
    """Return the constraints that follow from the largest number of objects."""
    index = {"type": "integer", "minimum": 0, "maximum": objects - 1}
    pairs = {
        "items": _fixed_array("two object indices from 0; blocks count before balls", index, index),
        "maxItems": objects * (objects - 1) // 2,
    }
    lists = {"block": objects - 1, "ball": objects, "eli": objects, "dynamic": objects}
    return {key: {"maxItems": most} for key, most in lists.items()} | {"joint": pairs, "spring": pairs}


def _array(description: str, **rules: object) -> dict[str, Any]:
    return {"description": description, "type": "array", **rules}


def _fixed_array(description: str, *items: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an array with exactly these items."""
    return _array(description, prefixItems=list(items), minItems=len(items), maxItems=len(items), items=False)
