"""JAX_DISABLE_JIT, the usual way to debug, changes no result: a process of its own, which compiles what it plays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PLAY = """
import jax, numpy as np
import iphyre_jax
print(jax.config.jax_disable_jit, *iphyre_jax.simulate("support", [[10, 20], [5, 20]], fps=10).reward)
env, params = iphyre_jax.make("on-the-fly/support-v1")
obs, state = env.reset(jax.random.key(0), params)
print(obs.shape, *[round(float(env.step(jax.random.key(0), state, action, params)[2]), 3) for action in (0, 1)])
"""


@pytest.mark.slow
@pytest.mark.further
@pytest.mark.parametrize("disable", ["0", "1"])
def test_simulate_and_environments(disable: str, tmp_path: Path) -> None:
    """Both print what is written here."""
    own = {"JAX_DISABLE_JIT": disable, "IPHYRE_JAX_CACHE": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", PLAY], env=os.environ | own, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout.splitlines() == [f"{disable == '1'} 976.8 976.3", "(122,) -0.1 -10.1"]
