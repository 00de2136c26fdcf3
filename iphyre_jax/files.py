"""Files: strict JSON from outside, and files that are whole at any moment."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import secrets
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import one_line, show

MAX_JSON_BYTES: Final = 1_000_000  # of a scene, a play, a request
MAX_JSON: Final = 2 * MAX_JSON_BYTES  # of a file of our own; parsed, it takes some 60 MB at most
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


def read_json_object(path: Path, max_bytes: int = MAX_JSON) -> dict[str, Any]:
    """Return the object that a JSON file of our own holds.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no JSON object; one line that names the file.
    """
    with path.open("rb") as file:
        content = parse_json(file.read(max_bytes + 1), one_line(str(path)), max_bytes)
    if not isinstance(content, dict):
        raise ValueError(f"{one_line(str(path))}: expected an object, got {show(content)}")
    return content


def read_versioned(path: Path, schema: str, versions: Sequence[int], max_bytes: int = MAX_JSON) -> dict[str, Any]:
    """Return the JSON object in a file of a schema.

    Args:
        path: of the file.
        schema: its field `schema`.
        versions: those of its field `version` that are read, the present one last.
        max_bytes: of the file.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such object; one line naming the file.
    """
    content = read_json_object(path, max_bytes)
    found = content.get("schema"), content.get("version")
    if found[0] != schema or found[1] not in versions:
        got = show(found[0]) if found[0] != schema else f"version {show(found[1])}"
        raise ValueError(f'{path}: expected schema "{schema}", version {versions[-1]}, got {got}')
    return content


def pack_npz(arrays: Mapping[str, npt.ArrayLike]) -> bytes:
    """Return a compressed NPZ file's bytes; equal arrays give equal bytes."""
    packed = io.BytesIO()
    np.savez_compressed(packed, **{name: np.asarray(array) for name, array in arrays.items()})  # type: ignore[arg-type]
    return packed.getvalue()


def read_npz(file: Path, max_bytes: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an NPZ file by name. It runs no code, and sizes are checked before anything is unpacked.

    Args:
        file: as `numpy.savez` or `savez_compressed` writes it; arrays of numbers only.
        max_bytes: of the file, and of all arrays together.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, too large, or an array is not what its header says; one line that names the array.
    """
    with file.open("rb") as opened:
        content = opened.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise ValueError(f"{file}: expected at most {max_bytes} bytes, got more")
    arrays: dict[str, npt.NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > max_bytes:
                raise ValueError(f"expected at most {max_bytes} bytes of arrays, got {unpacked}")
            for member in archive.infolist():
                name = member.filename.removesuffix(".npy")
                if name in arrays:
                    raise ValueError(f"{name}: expected this array once, got it again")
                arrays[name] = _read_array(archive, member)
    except Exception as error:  # archives and headers fail in many ways
        raise ValueError(f"{file}: expected arrays of NumPy: {one_line(str(error)) or 'the file is empty'}") from None
    return arrays


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """One array of an archive; no more bytes are unpacked than its header needs."""
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others unpack more than was asked for
        raise ValueError(f"{member.filename}: expected an array stored or deflated")
    with archive.open(member) as opened:
        version = np.lib.format.read_magic(opened)
        if version != (1, 0):
            raise ValueError(f"{member.filename}: expected version 1.0 of the array's format, got {version}")
        shape, columns_first, dtype = np.lib.format.read_array_header_1_0(opened)
        if dtype.kind not in "biuf":
            raise ValueError(f"{member.filename}: expected numbers, got dtype {dtype}")
        size = member.file_size - opened.tell()
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != size:
            raise ValueError(f"{member.filename}: expected {size} bytes, its header says shape {shape} of {dtype}")
        raw = opened.read(size)
    return np.frombuffer(raw, dtype).reshape(shape, order="F" if columns_first else "C")


def check_output(name: str, path: Path | None, suffixes: Sequence[str] = (".png",)) -> None:
    """Check the name of a file to write, before its contents are made; None is fine.

    Args:
        name: of the argument, for the message.
        path: the file.
        suffixes: endings, of which it must have one; none for any.

    Raises:
        ValueError: another ending, a folder, or one that does not exist; one line.
    """
    if path is None:
        return
    if path.is_dir():
        raise ValueError(f"{name}: expected the name of a file, got the folder {show(str(path))}")
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{name}: expected a file name that ends in {', '.join(suffixes)}, got {show(str(path))}")
    if not path.parent.is_dir():
        raise ValueError(f"{name}: expected a file in a folder that exists, got {show(str(path))}")


def check_apart(name: str, path: Path | None, other: str, file: Path | None) -> None:
    """Refuse a file to write that is the one of another argument; None is fine. ValueError in one line."""
    if path is not None and file is not None and path.resolve() == file.resolve():
        raise ValueError(f"{name}: expected another file than {other}, got {show(str(path))}")


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Give a name beside `target` to write to; what stands there at the end takes the target's place in one move.

    The name ends as the target's does, in lower case. After an error the target is as it was, and no draft stays. A
    link is replaced, not followed: a folder from outside may hold links to anywhere.
    """
    # Drawn: threads, and processes of equal numbers on other machines, may write the same file.
    draft = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.part{target.suffix.lower()}")
    try:
        with naming(target, draft):
            yield draft
            with draft.open("r+b") as file:  # on Windows only what may be written is flushed
                os.fsync(file.fileno())
            draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


@contextmanager
def naming(file: Path, draft: Path | None = None) -> Iterator[None]:
    """Let an error of the system name the file, as one of a full disk does not by itself, and one of its draft."""
    try:
        yield
    except OSError as error:
        if draft is not None and error.filename == str(draft):
            raise OSError(error.errno, error.strerror, str(file)) from error
        if error.errno is not None and error.filename is None:
            error.filename = str(file)
        raise


def file_sum(file: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits; OSError if it cannot be read."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def check_exist(*files: Path) -> None:
    """Raise FileNotFoundError, as opening it would, for the first of files that belong together that is missing."""
    there = {file: file.exists() for file in files}
    missing, found = ([file for file in files if there[file] is exists] for exists in (False, True))
    if missing:
        reason = f"expected this file beside {one_line(found[0].name)}, there is none" if found else ""
        raise FileNotFoundError(errno.ENOENT, reason or os.strerror(errno.ENOENT), str(missing[0]))


def check_writable(folder: Path, name: str) -> None:
    """Learn that a folder cannot be written, or made, before the work whose result goes there.

    Raises:
        PermissionError: it cannot; one line that begins with `name`.
    """
    there = next((part for part in (folder, *folder.absolute().parents) if part.exists()), folder)
    if not os.access(there, os.W_OK):
        raise PermissionError(f"{one_line(name)}: expected a folder that can be written, and {folder} cannot")


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
