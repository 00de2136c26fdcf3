"""Scene files: strict JSON on disk. Every error is one line that names the file."""

import json
import os
from pathlib import Path
from typing import Final, NoReturn

from iphyre_jax.scenes.codec import scene_from_dict, scene_to_dict
from iphyre_jax.scenes.errors import one_line, show
from iphyre_jax.scenes.limits import MAX_FILE_BYTES, Limits
from iphyre_jax.scenes.scene import Scene

_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"


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
        OSError: the file cannot be written.
    """
    target = Path(path)
    part = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        part.write_text(scene_text(scene), encoding="utf-8")
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def scene_text(scene: Scene) -> str:
    """Return the contents of a scene file, one field per line."""
    fields = ",\n".join(f' "{key}": {json.dumps(value)}' for key, value in scene_to_dict(scene).items())
    return f"{{\n{fields}\n}}\n"


def parse_json(content: bytes, source: str) -> object:
    """Parse strict JSON: UTF-8 without byte order mark, and no key twice in an object.

    NaN and Infinity pass, so that later checks can name their field.

    Args:
        content: the bytes of the file.
        source: the file that error messages name.

    Returns:
        The parsed value.

    Raises:
        ValueError: it is not strict JSON; one line.
    """
    name = one_line(source)

    def object_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        fields: dict[str, object] = {}
        for key, value in pairs:
            if key in fields:
                raise _RepeatedKeyError(f"{name}: {show(key)}: expected this field once, got it again")
            fields[key] = value
        return fields

    if len(content) > MAX_FILE_BYTES:
        raise ValueError(f"{name}: expected at most {MAX_FILE_BYTES} bytes, got more")
    if content.startswith(_BYTE_ORDER_MARK):
        raise ValueError(f"{name}: expected UTF-8 text without a byte order mark")
    try:
        return json.loads(content.decode("utf-8"), object_pairs_hook=object_once)
    except _RepeatedKeyError:
        raise
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: expected UTF-8 text, got another byte at offset {error.start}") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ValueError(f"{name}: expected JSON, got an error at {where}: {error.msg}") from None
    except RecursionError:
        raise ValueError(f"{name}: expected JSON of a few levels, got too many nested in each other") from None
    except ValueError:  # an integer of more digits than Python converts
        raise ValueError(f"{name}: expected numbers of ordinary length, got one of thousands of digits") from None


class _RepeatedKeyError(ValueError):
    """An object has a key twice."""


def _read_bytes(path: Path) -> bytes:
    """Read a regular file, at most one byte more than the allowed size."""
    name = one_line(str(path))
    try:
        if path.is_dir():
            raise IsADirectoryError(f"{name}: expected a scene file, got a folder")
        if path.exists() and not path.is_file():
            raise OSError(f"{name}: expected a scene file, got a device, pipe or socket")
        with path.open("rb") as file:
            return file.read(MAX_FILE_BYTES + 1)
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
