"""Executables in their own CPU client, which no setting of the user's JAX affects.

The client runs a program in the calling thread. So a callback of one program may call another without waiting for a
free thread, and any number of threads may call at once. Arrays go in and out as NumPy arrays; aligned ones are not
copied.
"""

from __future__ import annotations

import contextlib
import ctypes
from functools import cache, lru_cache
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
from jax.sharding import SingleDeviceSharding
from jaxlib import xla_client

from iphyre_jax.execution.forks import check_fork

Arrays = tuple[npt.NDArray[Any], ...]

ALIGNMENT = 64  # bytes


@cache
def _client() -> Any:  # noqa: ANN401 - jaxlib has no types
    return xla_client.make_cpu_client(asynchronous=False)


class Executable:
    """A loaded program, from arrays to NumPy arrays; any number of threads may call it.

    Args:
        payload: as the compiler process has written it.

    Raises:
        Exception: of any type, from jaxlib, for a payload that it cannot load.
    """

    def __init__(self, payload: bytes) -> None:
        self._loaded = _client().deserialize_executable(payload, xla_client.DeviceList(tuple(_devices())))

    def __call__(self, *arrays: npt.NDArray[Any] | ClientArray) -> Arrays:
        """Run the program; arrays must have its shapes and dtypes, and must not change before the call returns."""
        check_fork()
        given = [array.array if isinstance(array, ClientArray) else _device_put(array) for array in arrays]
        results = self._loaded.execute_sharded(given).disassemble_into_single_device_arrays()
        return tuple(np.asarray(shards[0]) for shards in results)


def serialized(compiled: jax.stages.Compiled) -> bytes:
    """Return a compiled function as `Executable` loads it."""
    executable: Any = compiled.runtime_executable()
    payload: bytes = executable.client.serialize_executable(executable)
    return payload


def give_back_memory() -> None:
    """Give freed memory back to the system; glibc keeps that of dropped programs, 20 MB each, until it is asked."""
    with contextlib.suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


class ClientArray:
    """An array of the client, which executables take without any work; it must not change.

    Args:
        array: with any strides.
    """

    def __init__(self, array: npt.NDArray[Any]) -> None:
        self.array = _device_put(array)


def _device_put(array: npt.NDArray[Any]) -> Any:  # noqa: ANN401
    try:
        return _put(array)
    except jax.errors.JaxRuntimeError:  # a guard against transfers, which means the user's devices; to ask costs 6 us
        with jax.transfer_guard("allow"):
            return _put(array)


def _put(array: npt.NDArray[Any]) -> Any:  # noqa: ANN401
    aval = _aval(array.shape, array.dtype)
    if array.itemsize == 8:  # otherwise 64 bits become 32, whatever the aval says
        with jax.enable_x64(True):
            return xla_client.batched_device_put(aval, _sharding(), [array], _devices(), True)
    return xla_client.batched_device_put(aval, _sharding(), [array], _devices(), True)


@lru_cache(4096)
def _aval(shape: tuple[int, ...], dtype: np.dtype[Any]) -> jax.core.ShapedArray:
    return jax.core.ShapedArray(shape, dtype)


@cache
def _devices() -> list[Any]:
    devices: list[Any] = _client().local_devices()[:1]
    return devices


@cache
def _sharding() -> SingleDeviceSharding:
    return SingleDeviceSharding(_devices()[0])


def aligned_size(size: int, alignment: int = ALIGNMENT) -> int:
    """Return the bytes that something of so many takes, if the next thing behind it is aligned."""
    return size + -size % alignment


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return an array of zeros that executables take without a copy."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + size].view(dtype).reshape(shape)
