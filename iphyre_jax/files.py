"""Files: strict JSON from outside, and files that are whole at any moment."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from iphyre_jax.checks import one_line, show

MAX_JSON_BYTES: Final = 1_000_000  # of a scene, a play, a request
_BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"


def parse_json(content: bytes, source: str, max_bytes: int = MAX_JSON_BYTES) -> object:
    """Parse strict JSON: UTF-8 without byte order mark, no key twice in an object.

    NaN and Infinity pass here, so that validation can name the field they stand in.

    Args:
        content: the bytes of the file.
        source: the file that a message names.
        max_bytes: more are refused.

    Returns:
        The parsed value.

    Raises:
        ValueError: it is not such JSON; one line.
    """
    name = one_line(source)

    def object_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        found: dict[str, object] = {}
        for key, value in pairs:
            if key in found:
                raise _RepeatedKeyError(f"{name}: {show(key)}: expected this field once, got it again")
            found[key] = value
        return found

    if len(content) > max_bytes:
        raise ValueError(f"{name}: expected at most {max_bytes} bytes, got more")
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
    """An object of the file has a key twice."""


def read_json_object(path: Path, max_bytes: int = 100 * MAX_JSON_BYTES) -> dict[str, Any]:
    """Return the object that a JSON file of our own holds.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no JSON object; one line that names the file.
    """
    with path.open("rb") as file:
        content = parse_json(file.read(max_bytes + 1), str(path), max_bytes)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected an object, got {type(content).__name__}")
    return content


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Give a name beside `target` to write to; what stands there at the end takes the target's place in one move.

    The name ends as the target's does, in lower case. After an error the target is as it was, and no draft stays.
    """
    draft = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix.lower()}")
    try:
        yield draft
        with draft.open("rb") as file:
            os.fsync(file.fileno())
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def replace_bytes(path: Path, content: bytes) -> None:
    """Write a file in place of an older one; it is whole at any moment."""
    with replacing(path) as draft:
        draft.write_bytes(content)


def replace_text(path: Path, text: str) -> None:
    """Write a text file, UTF-8, in place of an older one; it is whole at any moment."""
    replace_bytes(path, text.encode())


def replace_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON in place of an older file; it is whole at any moment."""
    replace_text(path, json.dumps(content, indent=1) + "\n")
