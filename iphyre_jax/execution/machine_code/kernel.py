"""What a serialised executable of XLA's CPU compiler says of its one kernel.

The messages are those of openxla/xla: `CompilationResultProto` in xla/service/cpu/executable.proto,
`BufferAssignmentProto` and `HloModuleProto` in xla/service, `ThunkProto` in xla/backends/cpu/runtime/thunk.proto.
Fields are named where they are read. Their numbers are those of jaxlib 0.10.2; `trial` finds out whether those of
another one differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

import numpy as np

from iphyre_jax.execution.compilation.client import aligned_size
from iphyre_jax.execution.machine_code.protobuf import Message, read_varint

# Fields of a literal that hold its numbers, as they are in memory: flags, bytes, floating-point numbers.
_PLAIN: Final = (2, 15, 3, 8, 9)
_VARINTS: Final[Mapping[int, str]] = {4: "int32", 5: "int64", 6: "uint32", 7: "uint64"}  # those that are packed


class Memory(Enum):
    """Whose memory a buffer is."""

    PARAMETER = auto()  # an argument of the program; also a result that takes its place
    CONSTANT = auto()
    SCRATCH = auto()  # of one call


@dataclass(frozen=True)
class Buffer:
    """What the kernel gets for one of its arguments.

    Attributes:
        memory: whose it is.
        number: of the parameter; else 0.
        offset: bytes from the start of that memory.
    """

    memory: Memory
    number: int
    offset: int


@dataclass(frozen=True)
class Kernel:
    """The one kernel of an executable.

    Attributes:
        name: of the function.
        object_file: its machine code, relocatable.
        buffers: what the function gets, in order.
        constants: one after the other.
        scratch_size: bytes that one call needs.
        in_place: numbers of the parameters whose memory receives a result.
    """

    name: str
    object_file: bytes
    buffers: tuple[Buffer, ...]
    constants: bytes
    scratch_size: int
    in_place: tuple[int, ...]

    @classmethod
    def of(cls, payload: bytes) -> Kernel:
        """Return the kernel of an executable as jaxlib has serialised it.

        Raises:
            ValueError: it has more than one kernel, or is of another form; one line.
        """
        size, start = read_varint(payload, 0)  # of a header
        result = Message(payload[start + size :]).message(1)
        thunks = result.message(6).all_messages(1)
        if [thunk.bytes(1) for thunk in thunks] != [b"kernel"]:
            kinds = ", ".join(thunk.bytes(1).decode(errors="replace") for thunk in thunks)
            raise ValueError(f"executable: expected one kernel, got {kinds}")
        kernel = thunks[0].message(11)
        constants = _literals(result.message(1, 1))  # of the HLO module
        assignment = result.message(2)
        memories, table, scratch_size = _memories(assignment, constants)
        slices = [part.message(1) for part in (*kernel.all_messages(5), *kernel.all_messages(6))]  # arguments, results
        buffers = []
        for part in slices:  # 1: offset, 3: allocation
            memory, number, offset = memories[part.number(3)]
            buffers.append(Buffer(memory, number, offset + part.number(1)))
        parameters = [part for part in assignment.all_messages(3) if part.number(5)]
        in_place = tuple(sorted(part.number(6) for part in parameters if part.number(7)))  # 7: holds a result
        object_file = result.message(8).bytes(1)
        return cls(kernel.bytes(1).decode(), object_file, tuple(buffers), table, scratch_size, in_place)

    def result_of(self, parameter: int) -> int | None:
        """Return which result takes the place of a parameter."""
        return self.in_place.index(parameter) if parameter in self.in_place else None


def _literals(module: Message) -> dict[int, bytes]:
    """Return the constants of a module by the instruction's number."""
    instructions = (one for computation in module.all_messages(3) for one in computation.all_messages(2))
    return {one.number(35): _literal(one.message(8)) for one in instructions if 8 in one}


def _literal(literal: Message) -> bytes:
    """Return the numbers of a constant as they are in memory; b"" for a tuple and the like."""
    plain = b"".join(part for field in _PLAIN for part in literal.all_bytes(field))
    for field, dtype in _VARINTS.items():
        for packed in literal.all_bytes(field):
            numbers, at = [], 0
            while at < len(packed):
                number, at = read_varint(packed, at)
                numbers.append(number)
            plain += np.array(numbers, np.uint64).astype(dtype).tobytes()
    return plain


def _memories(
    assignment: Message, literals: Mapping[int, bytes]
) -> tuple[dict[int, tuple[Memory, int, int]], bytes, int]:
    """Return each allocation as a memory, a number and an offset there, all constants, and the bytes of scratch."""
    # Of a logical buffer 1 is its number, 3 where it is defined, there 4 the instruction.
    defined_by = {buffer.number(1): buffer.message(3).number(4) for buffer in assignment.all_messages(1)}
    memories, table, scratch_size = {}, b"", 0
    for allocation in assignment.all_messages(3):
        index, size = allocation.number(1), allocation.number(2)
        if allocation.number(5):  # a parameter, 6 which
            memories[index] = Memory.PARAMETER, allocation.number(6), 0
        elif allocation.number(12):  # a constant; 9 the logical buffers in it
            held = [defined_by[part.number(1)] for part in allocation.all_messages(9)]
            (content,) = {literals[instruction] for instruction in held if instruction in literals}
            if len(content) != size:
                raise ValueError(f"constant: expected {size} bytes, got {len(content)}")
            memories[index] = Memory.CONSTANT, 0, len(table)
            table += content.ljust(aligned_size(size), b"\0")
        elif not allocation.number(3):  # not within a thread
            memories[index] = Memory.SCRATCH, 0, scratch_size
            scratch_size += aligned_size(size)
    return memories, table, scratch_size
