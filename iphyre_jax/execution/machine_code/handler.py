"""The few instructions between a program of XLA and a kernel: a handler of XLA's foreign function interface.

XLA calls a handler with an `XLA_FFI_CallFrame`, see jaxlib's include/xla/ffi/api/c_api.h. The kernel expects an
`XLA_CPU_KernelCallFrame`, see openxla/xla, xla/backends/cpu/runtime/kernel_c_api.h. The handler fills the one from the
other, on the stack, and calls the kernel. Both return a null pointer if nothing went wrong. A handler in Python would
hold the interpreter's lock, for which the devices of a program would wait.
"""

from __future__ import annotations

import struct
from typing import Final

from iphyre_jax.execution.compilation.client import ALIGNMENT, aligned_size
from iphyre_jax.execution.machine_code.kernel import Kernel, Memory

# Offsets in bytes. In XLA's frame: its extensions, the interface, and the pointers to arguments and results.
_EXTENSIONS, _API, _ARGUMENTS, _RESULTS = 8, 16, 72, 112
_DATA: Final = 24  # in the description of a buffer
# The one extension asks which version of the interface a handler has been made for: two 32-bit numbers.
_METADATA: Final = 24  # in the extension
_VERSION_OF_API, _VERSION_OF_METADATA = 32, 24
# In the kernel's frame: the numbers of work groups, which one this is, how many arguments, and where they are.
_GROUPS, _OWN_GROUP, _COUNT, _PLACE, _FRAME_SIZE = 0, 8, 16, 24, 32
_ARGUMENT_SIZE: Final = 16  # an address, and a size that only checks read
GROUPS: Final = struct.pack("<6Q", 1, 1, 1, 0, 0, 0)  # one work group; its number

# Registers of x86-64 by their number. The System V ABI has the first argument in RDI, and the result in RAX.
_RAX, _RCX, _RDX, _RSP, _RSI, _RDI = 0, 1, 2, 4, 6, 7
_ENTER: Final = b"\x55\x48\x89\xe5\x48\x83\xe4" + struct.pack("<b", -ALIGNMENT)  # push rbp; mov rbp, rsp; and rsp, ..
_RETURN: Final = b"\xc9\xc3"  # leave; ret
_RETURN_NULL: Final = b"\x31\xc0\xc3"  # xor eax, eax; ret
_IS_NULL: Final = b"\x48\x85\xc0"  # test rax, rax
_CALL: Final = b"\xff\xd0"  # call rax
_FRAME_IS_ARGUMENT: Final = b"\x48\x89\xe7"  # mov rdi, rsp


def handler_code(function: int, kernel: Kernel, constants: int, groups: int) -> bytes:
    """Return the machine code of a handler; it may stand anywhere.

    XLA gives it all parameters of the kernel that receive no result, then perhaps others. Its results are those that
    the kernel has in place, in their order, and scratch memory.

    Args:
        function: address of the kernel's function.
        kernel: what is called.
        constants: address of its constants.
        groups: address of `GROUPS`.
    """
    buffers = kernel.buffers
    tell_version = [
        *(_load(_RAX, _RDI, _API), _load(_RCX, _RAX, _VERSION_OF_API)),
        *(_load(_RAX, _RDI, _EXTENSIONS), _load(_RAX, _RAX, _METADATA), _store(_RAX, _VERSION_OF_METADATA, _RCX)),
        _RETURN_NULL,
    ]
    size = _FRAME_SIZE + _ARGUMENT_SIZE * len(buffers)
    code = [
        *(_load(_RAX, _RDI, _EXTENSIONS), _IS_NULL, _jump_if_zero(b"".join(tell_version)), *tell_version),
        *(_ENTER, _subtract_from_rsp(aligned_size(size))),
        *(_load(_RDX, _RDI, _ARGUMENTS), _load(_RSI, _RDI, _RESULTS)),
        *(_set_rax(groups), _store(_RSP, _GROUPS, _RAX), _set_rax(groups + 24), _store(_RSP, _OWN_GROUP, _RAX)),
        *(_set_rax(len(buffers)), _store(_RSP, _COUNT, _RAX)),
        *(_address_on_stack(_FRAME_SIZE), _store(_RSP, _PLACE, _RAX)),
    ]
    for k, buffer in enumerate(buffers):
        if buffer.memory is Memory.CONSTANT:
            code.append(_set_rax(constants + buffer.offset))
        else:
            result = len(kernel.in_place) if buffer.memory is Memory.SCRATCH else kernel.result_of(buffer.number)
            described = _load(_RAX, _RDX, 8 * buffer.number) if result is None else _load(_RAX, _RSI, 8 * result)
            code += [described, _load(_RAX, _RAX, _DATA), _add_to_rax(buffer.offset)]
        code.append(_store(_RSP, _FRAME_SIZE + _ARGUMENT_SIZE * k, _RAX))
    code += [_FRAME_IS_ARGUMENT, _set_rax(function), _CALL, _RETURN]
    return b"".join(code)


def _load(register: int, base: int, offset: int) -> bytes:
    """Return mov register, [base + offset]; base: not RSP."""
    return b"\x48\x8b" + bytes([0x80 | register << 3 | base]) + _int32(offset)


def _store(base: int, offset: int, register: int) -> bytes:
    """Return mov [base + offset], register."""
    after_base = b"\x24" if base == _RSP else b""
    return b"\x48\x89" + bytes([0x80 | register << 3 | base]) + after_base + _int32(offset)


def _set_rax(number: int) -> bytes:
    """Return mov rax, number."""
    return b"\x48\xb8" + struct.pack("<Q", number)


def _add_to_rax(number: int) -> bytes:
    """Return add rax, number."""
    return b"\x48\x05" + _int32(number)


def _address_on_stack(offset: int) -> bytes:
    """Return lea rax, [rsp + offset]."""
    return b"\x48\x8d\x84\x24" + _int32(offset)


def _subtract_from_rsp(size: int) -> bytes:
    """Return sub rsp, size."""
    return b"\x48\x81\xec" + _int32(size)


def _jump_if_zero(skipped: bytes) -> bytes:
    """Return jz to the place behind some code."""
    return b"\x74" + struct.pack("<b", len(skipped))


def _int32(number: int) -> bytes:
    return struct.pack("<i", number)
