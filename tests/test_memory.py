"""The memory of a call is known before it is asked for."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys

import numpy as np
import pytest

import iphyre_jax
from iphyre_jax import memory
from iphyre_jax.adapters import GymnasiumVectorEnv
from iphyre_jax.scenes import load_scene, vary
from iphyre_jax.viewer.play.worker import memory_in_use


def test_a_call_is_refused_with_both_figures_and_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 10**9)
    memory.check_memory("count", 10**9, "draw fewer")
    with pytest.raises(ValueError, match=r"^count: expected .* 1 GB, the memory that is free, got 1\.5 GB; draw few"):
        memory.check_memory("count", 1.5e9, "draw fewer")


@pytest.mark.parametrize("name", ["sample_every", "eliminate_at", "episodes", "count", "num_envs", "times"])
def test_every_call_of_any_size_asks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes a gigabyte or less, for which there is no room here."""
    monkeypatch.setattr(memory, "available", lambda: 0)

    def nothing(key: object, obs: object) -> object:
        del key
        return obs

    calls = {
        "sample_every": lambda: iphyre_jax.simulate("hole", np.zeros((5000, 1), int), sample_every=1),
        "eliminate_at": lambda: iphyre_jax.simulate_many(  # results alone are a third of what is asked for
            ["hole"], np.zeros(120_000, int), np.zeros((120_000, 1), int), share_prefixes=True
        ),
        "episodes": lambda: iphyre_jax.evaluate(nothing, ["hole"], strategy="on-the-fly", episodes=30_000),
        "count": lambda: vary(load_scene("hole"), 20_000),
        "num_envs": lambda: GymnasiumVectorEnv("in-advance/hole-v1", 200_000),
        "times": lambda: iphyre_jax.plan_to_steps(np.ones((2, 4000)), 10, "in_advance"),
    }
    with pytest.raises(ValueError, match=rf"^{name}: expected a call of at most 0 GB[^\n]*; [^\n]*$"):
        calls[name]()


def test_what_is_free_is_the_least_of_machine_group_and_process(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 0 < memory.available() < 2**50
    for part in ("_of_machine", "_of_control_group", "_of_process"):
        with monkeypatch.context() as patch:
            patch.setattr(memory, part, lambda: 5)
            assert memory.available() == 5


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of address space is Linux's")
def test_a_limit_of_the_process_counts() -> None:
    script = (
        "import resource; from iphyre_jax import memory; resource.setrlimit(resource.RLIMIT_AS, (3 * 10**9,) * 2);"
        "print(memory.available())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert 0 < int(done.stdout) < 3 * 10**9


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the limit of address space is Linux's")
def test_too_little_room_for_jax_to_start_gets_one_line() -> None:
    """Without the check the libraries of JAX abort, with a trace of machine code and no exception."""
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (10**9,) * 2);"
        "from iphyre_jax.cli.main import run; sys.exit(run(['simulate', 'hole']))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    wanted = r"iphyre-jax: ulimit -v: expected 1.1 GB of address space for JAX to start, got 0\.\d+ GB; allow [^\n]+\n"
    assert re.fullmatch(wanted, done.stderr)


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="other systems decide themselves"
)
def test_what_is_forgotten_goes_back_to_the_system() -> None:
    """200 MB in small pieces, of which one of a hundred is still in use."""
    pieces = [bytearray(2000) for _ in range(100_000)]
    full, kept = memory_in_use(), pieces[::100]
    del pieces
    assert memory_in_use() > full - 50e6
    memory.forget_programs()
    assert memory_in_use() < full - 100e6
    assert len(kept) == 1000
