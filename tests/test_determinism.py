"""What stays equal bit for bit from process to process (the section Determinism of docs/reference/parity.md).

Others: a world's neighbours and its place, tests/physics/test_batching.py; threads,
tests/execution/compilation/test_executables.py; training, tests/train/storage/test_runs.py.
"""

import os
import platform
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib
import numpy as np
import iphyre_jax
{prelude}
plans = np.random.default_rng(0).integers(-1, 60, (20, 4))
for dtype in ("float64", "float32"):
    played = iphyre_jax.simulate("hole", plans, fps=10, dtype=dtype, sample_every=1)
    print(hashlib.sha256(played.samples.tobytes()).hexdigest(), hash(tuple(played.steps.tolist())))
"""
# Neither our options nor wide vectors nor fused multiply-adds.
OLD_PROCESSOR = """
from iphyre_jax.execution.compilation import executables
executables.options_for = lambda lanes: {options}
"""
ONE_THREAD = "iphyre_jax.configure(cache=False, devices=1)"


def bits(prelude: str = "") -> list[list[str]]:
    """Hashes of all poses and of the steps made, in float64 and in float32, from a process of its own."""
    own = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    program = PROGRAM.format(prelude=prelude)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, env=own)
    assert done.returncode == 0, done.stderr
    return [line.split() for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_bits_depend_on_no_process_and_float64_on_no_compiler_option_or_instruction_set() -> None:
    here = bits()
    assert bits(ONE_THREAD) == here
    options = {"--xla_cpu_max_isa": "SSE4_2"} if platform.machine() in ("x86_64", "AMD64") else {}
    double, single = bits(OLD_PROCESSOR.format(options=options))
    assert double == here[0]
    assert single[1] == here[1][1]  # the steps made; float32 may be rounded otherwise
