"""Relocatable object files of machine code, put into this process's memory: ELF, x86-64.

The format is https://refspecs.linuxfoundation.org/elf/elf.pdf and https://gitlab.com/x86-psABIs/x86-64-ABI. XLA
compiles for the large code model, so nearly all addresses are whole 64-bit ones.
"""

from __future__ import annotations

import ctypes
import mmap
import platform
import struct
import sys
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

from iphyre_jax.execution.compilation.client import aligned_size

_PROGRAM, _SYMBOLS, _RELOCATIONS, _ZEROS = 1, 2, 4, 8  # types of sections
_WRITTEN, _LOADED = 1, 2  # flags of sections
# Types of relocations: the target's address, or how far it is from the place; format of what is stored there.
_ABSOLUTE: Final = {1: "<Q"}
_RELATIVE: Final = {24: "<q", 2: "<i", 4: "<i"}


def can_link() -> bool:
    """Return whether this is a machine whose object files are known: Linux on x86-64."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


class Section(NamedTuple):
    """The header of a part of an object file, as it stands there."""

    name: int
    type: int
    flags: int
    address: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int
    entry_size: int


class Symbol(NamedTuple):
    """A name of an object file."""

    name: str
    section: int  # 0 if it is somewhere else
    value: int  # offset in the section


@dataclass(frozen=True)
class ObjectFile:
    """The parts of an object file.

    Attributes:
        content: its bytes.
        sections: all of them.
        symbols: all of them.
    """

    content: bytes
    sections: tuple[Section, ...]
    symbols: tuple[Symbol, ...]

    @classmethod
    def of(cls, content: bytes) -> ObjectFile:
        """Return the parts of an object file.

        Raises:
            ValueError: it is none of ELF for x86-64; one line.
        """
        if content[:6] != b"\x7fELF\x02\x01" or struct.unpack_from("<HH", content, 16) != (1, 62):
            raise ValueError("object file: expected a relocatable one, ELF for x86-64")
        (start,), (count,) = struct.unpack_from("<Q", content, 40), struct.unpack_from("<H", content, 60)
        sections = tuple(Section(*struct.unpack_from("<IIQQQQIIQQ", content, start + 64 * k)) for k in range(count))
        (table,) = [section for section in sections if section.type == _SYMBOLS]
        names = sections[table.link].offset

        def symbol(at: int) -> Symbol:
            name, _, _, section, value, _ = struct.unpack_from("<IBBHQQ", content, at)
            end = content.index(b"\0", names + name)
            return Symbol(content[names + name : end].decode(), section, value)

        places = range(table.offset, table.offset + table.size, 24)
        return cls(content, sections, tuple(map(symbol, places)))


class Code:
    """Memory with machine code, which stays as long as the process: a program of the user may be running in it.

    Args:
        object_file: is put there.
        constants: are put behind it.
        room: bytes that are kept behind these.

    Raises:
        ValueError: the object file has something unknown; one line.
        OSError: the system gives no memory.
    """

    def __init__(self, object_file: ObjectFile, constants: bytes, room: int) -> None:
        self._file, self._places, size = object_file, dict[int, int](), 0
        for number, section in enumerate(object_file.sections):
            if section.flags & _LOADED and section.type in (_PROGRAM, _ZEROS):
                if section.flags & _WRITTEN:
                    raise ValueError("object file: expected no memory that is written")
                self._places[number] = size
                size = aligned_size(size + section.size)
        self._room = aligned_size(size + len(constants))
        self._image = bytearray(aligned_size(self._room + room, mmap.PAGESIZE))
        self._start = _new_memory(len(self._image))
        self.constants, self.room = self._start + size, self._start + self._room  # their addresses
        for number, place in self._places.items():
            section = object_file.sections[number]
            if section.type == _PROGRAM:
                self._write(place, object_file.content[section.offset : section.offset + section.size])
        self._write(size, constants)
        self._relocate()

    def address_of(self, name: str) -> int:
        """Return the address of a function or object of the file."""
        for symbol in self._file.symbols:
            if symbol.name == name and symbol.section:
                return self._target(symbol)
        raise ValueError(f"object file: expected a symbol {name}")

    def finish(self, content: bytes) -> None:
        """Put machine code into the room behind, and make all of it executable, and read-only.

        Raises:
            OSError: the system does not allow it.
        """
        self._write(self._room, content)
        ctypes.memmove(self._start, bytes(self._image), len(self._image))
        if _libc().mprotect(ctypes.c_void_p(self._start), len(self._image), mmap.PROT_READ | mmap.PROT_EXEC):
            raise OSError(ctypes.get_errno(), "the system allows no machine code in memory")
        self._image.clear()

    def _write(self, place: int, content: bytes) -> None:
        self._image[place : place + len(content)] = content

    def _relocate(self) -> None:
        for section in self._file.sections:
            if section.type != _RELOCATIONS or section.info not in self._places:
                continue
            for at in range(section.offset, section.offset + section.size, 24):
                offset, info, addend = struct.unpack_from("<QQq", self._file.content, at)
                symbol, kind = self._file.symbols[info >> 32], info & 0xFFFFFFFF
                place, target = self._places[section.info] + offset, self._target(symbol) + addend
                if kind in _ABSOLUTE:
                    struct.pack_into(_ABSOLUTE[kind], self._image, place, target)
                elif kind in _RELATIVE:
                    struct.pack_into(_RELATIVE[kind], self._image, place, target - self._start - place)
                else:
                    raise ValueError(f"object file: expected relocations of known types, got {kind}")

    def _target(self, symbol: Symbol) -> int:
        if not symbol.section:
            return _function(symbol.name)
        if symbol.section not in self._places:
            raise ValueError(f"object file: expected symbols of its own code, got {symbol.name or symbol.section}")
        return self._start + self._places[symbol.section] + symbol.value


@cache
def _libc() -> ctypes.CDLL:
    library = ctypes.CDLL(None, use_errno=True)
    library.mmap.restype = ctypes.c_void_p
    library.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    library.mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    return library


def _new_memory(size: int) -> int:
    """Return the address of new memory; nothing gives it back."""
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
    address: int | None = _libc().mmap(None, size, mmap.PROT_READ | mmap.PROT_WRITE, flags, -1, 0)
    if address is None or address == ctypes.c_void_p(-1).value:
        raise OSError(ctypes.get_errno(), "the system gives no memory for machine code")
    return address


def _function(name: str) -> int:
    """Return the address of a function of the C library, or of its mathematical part."""
    library = _libc() if hasattr(_libc(), name) else ctypes.CDLL("libm.so.6")
    if not hasattr(library, name):
        raise ValueError(f"object file: expected functions of the C library, got {name}")
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
