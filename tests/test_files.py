"""Files from outside: archives of arrays whose sizes lie, a lock that outlives no process."""

from __future__ import annotations

import io
import os
import tracemalloc
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.files import read_npz, replace_bytes, replace_json
from iphyre_jax.locks import LOCK, locked

MOST = 2**20


def header(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": dtype, "fortran_order": False, "shape": shape})
    return out.getvalue()


def archive(compression: int = zipfile.ZIP_DEFLATED, **members: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as opened:
        for name, content in members.items():
            opened.writestr(f"{name}.npy", content)
    return out.getvalue()


def lying() -> bytes:
    """The directory says ten bytes; unpacked there are as many as make a gigabyte."""
    raw = bytearray(archive(a=header((2**28,)) + bytes(2**22)))
    place = raw.rindex(b"PK\x01\x02") + 24  # the unpacked size in the directory
    raw[place : place + 4] = (200).to_bytes(4, "little")
    return bytes(raw)


BAD = {
    "empty": (b"", "expected arrays of NumPy"),
    "no archive": (b"\x93NUMPY\x01\x00", "expected arrays of NumPy: File is not a zip file"),
    "no array": (archive(a=b""), "expected arrays of NumPy"),
    "bomb": (archive(a=bytes(2**22)), "expected at most 1048576 bytes of arrays, got 4194304"),
    "many": (archive(**{f"a{k}": bytes(2**16) for k in range(20)}), "bytes of arrays, got 1310720"),
    "large header": (archive(a=header((2**40,)) + bytes(8)), r"a.npy: expected 8 bytes, its header says shape \(1099"),
    "small header": (archive(a=header((1,)) + bytes(8)), r"a.npy: expected 8 bytes, its header says shape \(1,\)"),
    "negative": (archive(a=header((-1, -2)) + bytes(8)), r"its header says shape \(-1, -2\)"),
    "no size": (archive(a=header((0, 2**70))), "expected arrays of NumPy"),
    "deep header": (archive(a=b"\x93NUMPY\x01\x00\x10\x27" + b"(" * 10_000), "expected arrays of NumPy"),
    "objects": (archive(a=header((1,), "|O") + bytes(8)), "a.npy: expected numbers, got dtype object"),
    "text": (archive(a=header((1,), "<U2") + bytes(8)), "a.npy: expected numbers"),
    "version": (archive(a=b"\x93NUMPY\x09\x00" + bytes(99)), r"a.npy: expected version 1.0 of the array's format"),
    "packed otherwise": (archive(zipfile.ZIP_LZMA, a=header((1,)) + bytes(4)), "expected an array stored or deflated"),
    "lying directory": (lying(), "expected arrays of NumPy"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_archives_are_refused_in_one_line_and_little_memory(case: str, tmp_path: Path) -> None:
    content, message = BAD[case]
    file = tmp_path / "arrays.npz"
    file.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ValueError, match=message) as error:
        read_npz(file, MOST)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(error.value).startswith(f"{file}: ")
    assert "\n" not in str(error.value)
    assert peak < 8 * MOST


def test_arrays_come_back(tmp_path: Path) -> None:
    arrays = {
        "a.b": np.arange(6.0).reshape(2, 3),
        "half": np.ones((3, 1), np.float16),
        "none": np.zeros((0, 4)),
        "n": 3,
    }
    arrays |= {"n": np.asarray(3), "columns": np.asfortranarray(arrays["a.b"])}
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "arrays.npz", **arrays)  # type: ignore[arg-type]
        found = read_npz(tmp_path / "arrays.npz", MOST)
        assert found.keys() == arrays.keys()
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
            assert found[name].dtype == np.asarray(array).dtype
    with pytest.raises(ValueError, match="expected at most 100 bytes, got more"):
        read_npz(tmp_path / "arrays.npz", 100)


def test_an_error_names_the_file_and_not_its_draft(tmp_path: Path) -> None:
    target = tmp_path / "none" / "a.json"
    with pytest.raises(FileNotFoundError) as caught:
        replace_json(target, {})
    assert str(caught.value) == f"[Errno 2] No such file or directory: '{target}'"


def test_threads_write_one_file_and_it_is_whole_at_any_moment(tmp_path: Path) -> None:
    target, contents = tmp_path / "a.bin", [bytes([k]) * 100_000 for k in range(3)]
    replace_bytes(target, contents[0])
    with ThreadPoolExecutor(len(contents)) as threads:
        writing = [
            threads.submit(lambda content=content: [replace_bytes(target, content) for _ in range(30)])
            for content in contents
        ]
        while not all(one.done() for one in writing):
            assert target.read_bytes() in contents
    for one in writing:
        one.result()
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_a_lock_is_exclusive_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text("process 1 on another machine")  # of a process that was killed
    with locked(tmp_path):
        assert (tmp_path / LOCK).read_text().startswith(f"process {os.getpid()} on ")
        with (
            pytest.raises(BlockingIOError, match=f"expected a folder that nobody uses, but process {os.getpid()} on "),
            locked(tmp_path),
        ):
            pytest.fail("two hold it")
    assert not any(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError, match="of the body"), locked(tmp_path):
        raise FileNotFoundError("of the body")
    assert not any(tmp_path.iterdir())
