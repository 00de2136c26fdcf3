"""Object files in memory."""

from __future__ import annotations

import ctypes
import struct

import pytest

from iphyre_jax.execution.machine_code.linking import Code, ObjectFile, can_link

pytestmark = pytest.mark.skipif(not can_link(), reason="links on Linux with x86-64")
LOADED, WRITTEN = 2, 1
HEADER = 64


def object_file(
    code: bytes = b"", symbol: str = "answer", section: int = 1, kind: int = 1, flags: int = LOADED, addend: int = 0
) -> bytes:
    """An object file with one section of code, one symbol, and one relocation at byte 2 of the code."""
    code = code or b"\x48\xb8" + bytes(8) + b"\xc3"  # mov rax, number; ret
    names = b"\0" + symbol.encode() + b"\0"
    symbols = bytes(24) + struct.pack("<IBBHQQ", 1, 0x12, 0, section, 0, len(code))
    relocations = struct.pack("<QQq", 2, 1 << 32 | kind, addend)
    parts = [code, names, symbols, relocations]
    starts = [HEADER + sum(map(len, parts[:k])) for k in range(len(parts))]
    types = [(1, flags, 0, 0), (3, 0, 0, 0), (2, 0, 2, 1), (4, 0, 3, 1)]
    headers = bytes(64)
    for start, part, (type_, flag, link, info) in zip(starts, parts, types, strict=True):
        headers += struct.pack("<IIQQQQIIQQ", 0, type_, flag, 0, start, len(part), link, info, 1, 24)
    body = b"".join(parts)
    begin = (
        b"\x7fELF\x02\x01"
        + bytes(10)
        + struct.pack("<HHIQQQIHHHHHH", 1, 62, 1, 0, 0, HEADER + len(body), 0, 64, 0, 0, 64, 5, 0)
    )
    return begin + body + headers


def linked(content: bytes, constants: bytes = b"") -> Code:
    code = Code(ObjectFile.of(content), constants, 1)
    code.finish(b"\xc3")
    return code


def called(code: Code) -> int:
    number: int = ctypes.CFUNCTYPE(ctypes.c_uint64)(code.address_of("answer"))()
    return number


def test_an_address_is_put_into_the_code() -> None:
    code = linked(object_file(addend=5), b"constants")
    assert called(code) == code.address_of("answer") + 5
    assert ctypes.string_at(code.constants, 9) == b"constants"
    assert code.room % 64 == code.constants % 64 == 0


def test_a_distance_is_put_into_the_code() -> None:
    assert called(linked(object_file(kind=24))) == 2**64 - 2


def test_functions_of_the_c_library_are_found() -> None:
    for name in ("memcpy", "cos"):
        assert ObjectFile.of(object_file(symbol=name, section=0)).symbols[1].name == name
        Code(ObjectFile.of(object_file(symbol=name, section=0)), b"", 0)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\x7fELF" + bytes(60), "ELF for x86-64"),
        (object_file(symbol="no_such_function_anywhere", section=0), "functions of the C library"),
        (object_file(kind=9), "known types, got 9"),
        (object_file(flags=LOADED | WRITTEN), "no memory that is written"),
        (object_file(section=2), "symbols of its own code"),
    ],
)
def test_what_is_unknown_is_refused(content: bytes, expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as raised:
        linked(content)
    assert "\n" not in str(raised.value)


def test_a_symbol_that_is_missing_is_named() -> None:
    with pytest.raises(ValueError, match="expected a symbol nothing"):
        linked(object_file()).address_of("nothing")
