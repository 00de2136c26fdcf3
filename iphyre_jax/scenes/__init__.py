"""Scenes: the games of the package, and scene files, read and validated."""

import warnings

from iphyre_jax.scenes.builder import ObjectRef, SceneBuilder
from iphyre_jax.scenes.codec import SCENE_SCHEMA, SCENE_VERSION, scene_from_dict, scene_to_dict
from iphyre_jax.scenes.files import read_scene, write_scene
from iphyre_jax.scenes.json_schema import scene_json_schema
from iphyre_jax.scenes.library import GAMES, SPLITS, SceneLike, load_scene, load_scenes
from iphyre_jax.scenes.limits import MAX_ELIMINABLE, MAX_OBJECTS, Limits
from iphyre_jax.scenes.scene import Scene
from iphyre_jax.scenes.variations import Variations, vary

__all__ = [
    "GAMES",
    "MAX_ELIMINABLE",
    "MAX_OBJECTS",
    "SCENE_SCHEMA",
    "SCENE_VERSION",
    "SPLITS",
    "Limits",
    "ObjectRef",
    "Scene",
    "SceneBuilder",
    "SceneLike",
    "Variations",
    "load_scene",
    "load_scenes",
    "read_scene",
    "scene_from_dict",
    "scene_json_schema",
    "scene_to_dict",
    "vary",
    "write_scene",
]


def __getattr__(name: str) -> object:
    """Serve the old name of `ObjectRef` for one version."""
    if name != "Part":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn("iphyre_jax.scenes.Part is now called ObjectRef", DeprecationWarning, stacklevel=2)
    return ObjectRef
