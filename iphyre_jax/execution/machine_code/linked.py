"""A program that our compiler processes compiled, as one operation of the user's program."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Sequence
from typing import Final

import jax
import numpy as np

from iphyre_jax.execution.machine_code.handler import GROUPS, handler_code
from iphyre_jax.execution.machine_code.kernel import Kernel
from iphyre_jax.execution.machine_code.linking import Code, ObjectFile

# A program may be compiled for tables of so many rows, at least a byte each, and called with fewer. A copy of such a
# table would read what is behind it; it shows in the memory that the program needs.
MOST_ROWS: Final = 1 << 22
_registered: set[str] = set()  # names of kernels in this process


class LinkedProgram:
    """A loaded program, a function of arrays of the user's program; traced. It stays as long as the process.

    Args:
        payload: as the compiler process has written it.
        in_place: how many of its last arguments receive its results, one each.

    Raises:
        ValueError: the payload is of an unknown form; one line.
        OSError: the system allows no machine code in memory.
    """

    def __init__(self, payload: bytes, in_place: int) -> None:
        kernel = Kernel.of(payload)
        first = kernel.in_place[0] if kernel.in_place else 0
        if kernel.in_place != tuple(range(first, first + in_place)):
            raise ValueError(f"executable: expected {in_place} results in place of its last arguments")
        if kernel.scratch_size >= MOST_ROWS:
            raise ValueError("executable: expected rows alone to be copied, got a copy of a whole table")
        # Equal programs have one name in every process, so that JAX's cache of executables knows the user's programs.
        self._name = f"iphyre_jax_{hashlib.sha256(payload).hexdigest()[:32]}"
        self._in_place, self._scratch = in_place, jax.ShapeDtypeStruct((kernel.scratch_size,), np.uint8)
        _register(self._name, kernel)

    def __call__(self, *arguments: jax.Array | jax.ShapeDtypeStruct) -> list[jax.Array]:
        """Return what the program leaves in its last arguments, which change in place.

        Tables may have fewer rows than the program was compiled for, if it reads and writes only those. One of the
        last arguments may be a shape, if the program only writes it: nobody then fills it before.
        """
        kept = len(arguments) - self._in_place
        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in arguments[kept:]]
        filled = [k for k, leaf in enumerate(arguments[kept:]) if not isinstance(leaf, jax.ShapeDtypeStruct)]
        aliases = {kept + place: k for place, k in enumerate(filled)}
        call = jax.ffi.ffi_call(self._name, [*shapes, self._scratch], input_output_aliases=aliases)
        results: Sequence[jax.Array] = call(*arguments[:kept], *(arguments[kept + k] for k in filled))
        return list(results[: self._in_place])


def _register(name: str, kernel: Kernel) -> None:
    """Link a kernel and tell XLA its name, once."""
    if name in _registered:
        return

    def code_at(function: int, constants: int) -> bytes:
        return handler_code(function, kernel, constants, constants + len(kernel.constants))

    code = Code(ObjectFile.of(kernel.object_file), kernel.constants + GROUPS, len(code_at(0, 0)))
    code.finish(code_at(code.address_of(kernel.name), code.constants))
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(ctypes.c_void_p(code.room)), platform="cpu")
    _registered.add(name)
