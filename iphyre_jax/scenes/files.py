"""Scene files: strict JSON on disk. Every error is one line that names the file."""

import json
import os
from pathlib import Path
from typing import NoReturn

from iphyre_jax.checks import one_line
from iphyre_jax.files import MAX_JSON_BYTES, check_output, parse_json, replace_text
from iphyre_jax.scenes.codec import scene_from_dict, scene_to_dict
from iphyre_jax.scenes.limits import Limits
from iphyre_jax.scenes.scene import Scene


def read_scene(path: str | os.PathLike[str], limits: Limits | None = None) -> Scene:
    """Read and validate a scene file; `iphyre_jax.scenes.codec` describes the format.

    Args:
        path: the file.
        limits: of the scene; they replace those in the file.

    Returns:
        The scene.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: it cannot be read, or is a folder or a device.
        ValueError: the contents are wrong; one line for each wrong field.
    """
    source = str(path)
    return scene_from_dict(parse_json(_read_bytes(Path(path)), source), source, limits)


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file, which `read_scene` reads back as an equal scene. An existing file is replaced as a whole.

    Args:
        scene: any scene.
        path: the file; its folder must exist.

    Raises:
        ValueError: a folder, or a file in one that does not exist; one line.
        OSError: the file cannot be written.
    """
    check_output("path", Path(path), ())
    replace_text(Path(path), scene_text(scene))


def scene_text(scene: Scene) -> str:
    """Return the contents of a scene file, one field per line."""
    fields = ",\n".join(f' "{key}": {json.dumps(value)}' for key, value in scene_to_dict(scene).items())
    return f"{{\n{fields}\n}}\n"


def _read_bytes(path: Path) -> bytes:
    """Read a regular file, at most one byte more than the allowed size."""
    name = one_line(str(path))
    try:
        if path.is_dir():
            raise IsADirectoryError(f"{name}: expected a scene file, got a folder")
        if path.exists() and not path.is_file():
            raise OSError(f"{name}: expected a scene file, got a device, pipe or socket")
        with path.open("rb") as file:
            return file.read(MAX_JSON_BYTES + 1)
    except FileNotFoundError:
        raise FileNotFoundError(f"{name}: expected a scene file, but there is none") from None
    except OSError as error:
        _raise_unreadable(name, error)
    except ValueError:
        raise ValueError(f"{name}: expected the path of a scene file, got a text with a null byte") from None


def _raise_unreadable(name: str, error: OSError) -> NoReturn:
    """Raise an error of the operating system as one line; an error that names the file already is not changed."""
    if error.errno is None:
        raise error
    raise type(error)(f"{name}: expected a scene file that can be read, got: {error.strerror}") from None
