"""Several devices and processes: the bits of one. That chunks and threads change nothing is in tests/physics."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from jax.experimental import multihost_utils

from iphyre_jax import simulate, simulate_many
from iphyre_jax.execution import devices

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "two_processes.py"
# A spring's damping is two numbers, one for each kind of its ends: not lanes, though there are two devices.
CASES = (("spring", "float32"), ("hole", "float64"))
PLAY = """
import hashlib
import numpy as np
import iphyre_jax
def digest(game, dtype, mesh):
    plans = np.random.default_rng(0).integers(-1, 60, (600, 2))
    played = iphyre_jax.simulate(game, plans, fps=10, dtype=dtype, sample_every=50, mesh=mesh)
    found = played.steps, played.reward, played.samples
    return hashlib.sha256(b"".join(array.tobytes() for array in found)).hexdigest()
"""
TWO_DEVICES = f"""{PLAY}
import jax
iphyre_jax.configure(devices=2)
mesh = jax.make_mesh((2, 1), ("a", "b"))
for game, dtype in {CASES}:
    print(len(jax.devices()), digest(game, dtype, mesh))
"""


def told(*arguments: str) -> list[list[str]]:
    """The words of a Python process's lines."""
    kept = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    around = {**kept, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *arguments], env=around, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [line.split() for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_two_devices_give_the_bits_of_one() -> None:
    here: dict[str, Any] = {}
    exec(PLAY, here)  # noqa: S102 - our own words, as the other process has them
    assert told("-c", TWO_DEVICES) == [["2", here["digest"](*case, None)] for case in CASES]


@pytest.mark.slow
def test_two_processes_give_the_bits_of_one() -> None:
    """The example, as it stands; both processes have the whole result."""
    example = runpy.run_path(str(EXAMPLE))
    played = example["play"](None)
    expected = ["2", str(played.success.sum()), example["digest"](played)]
    lines = [line for line in told(str(EXAMPLE)) if len(line) == 4]
    assert sorted(lines) == [["0", *expected], ["1", *expected]]


def test_the_mesh_is_checked() -> None:
    with pytest.raises(ValueError, match=r"^mesh: expected a jax\.sharding\.Mesh, .* got 2$"):
        simulate("hole", [[-1] * 4], mesh=2)  # type: ignore[arg-type]


def test_no_worlds_on_a_mesh() -> None:
    mesh = jax.make_mesh((1,), ("worlds",))
    assert len(simulate_many(["hole"], [], np.zeros((0, 4), int), mesh=mesh).steps) == 0


@pytest.fixture
def second(monkeypatch: pytest.MonkeyPatch) -> tuple[devices.Partition, list[Any]]:
    """The second of two processes, and the list of what the first one tells it."""
    first: list[Any] = []
    monkeypatch.setattr(
        multihost_utils, "process_allgather", lambda own: np.stack([first.pop(0) if first else own, own])
    )
    return devices.Partition(None, process_index=1, process_count=2), first


def test_rows_of_all_processes_are_gathered(second: tuple[devices.Partition, list[Any]]) -> None:
    partition, first = second
    array = np.array([[0.0, 0], [0, 0], [1, 2], [0, 0]])
    first.append(np.array([[5.0, np.nan], [1e-300, 8], [9, 10]]))
    devices.gather(partition, [np.array([3, 0, 1]), np.array([2])], array)
    np.testing.assert_array_equal(array, [[1e-300, 8], [9, 10], [1, 2], [5, np.nan]])


def test_processes_must_make_the_same_call(second: tuple[devices.Partition, list[Any]]) -> None:
    _, first = second
    devices.check_same_call(np.arange(3), "same")
    first.append(np.zeros(32, np.uint8))
    with pytest.raises(ValueError, match=r"^mesh: .* must all make the same call"):
        devices.check_same_call(np.arange(3), "other")
