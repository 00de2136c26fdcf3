"""A child forked after use ends with one line instead of hanging; one forked before, or that never asks, lives."""

from __future__ import annotations

import subprocess
import sys

import pytest

PRELUDE = """
import os, signal, subprocess, sys, warnings
warnings.simplefilter("ignore")  # JAX's own, at each fork
import jax, numpy as np
import iphyre_jax
from iphyre_jax.compat import IPHYRE
from iphyre_jax.envs.batching.unrolling import Batch, unroll
from iphyre_jax.viewer.recording import record
PLANS = [[-1, 3, -1, 9]] * 3
key = lambda _: jax.numpy.zeros(2, "uint32")  # no key is made, so that the children would have to compile it
def policy(key, obs): return jax.numpy.zeros((), jax.numpy.int32)
def act(weights, key, obs): return jax.numpy.zeros((), jax.numpy.int32), ()
def forked(call):
    child = os.fork()
    if not child:
        signal.alarm(20)  # ends a child that hangs
        try:
            call()
            print("nothing was raised", flush=True)
        except RuntimeError as error:
            print(error, flush=True)
        os._exit(0)
    return os.waitpid(child, 0)[1]
"""

USED = (
    PRELUDE
    + """
env, params = iphyre_jax.make("on-the-fly/hole-v1")
obs, state = env.reset(key(0), params)
env.step(key(0), state, 0, params)
batch = Batch.of(env, params, [0, 0])
unroll(env, act, (), batch, key(0), decisions=1)
iphyre_jax.simulate("hole", PLANS, fps=10)
zero = key(0)
calls = {
    "simulate": lambda: iphyre_jax.simulate("hole", PLANS, fps=10),
    "simulate_many": lambda: iphyre_jax.simulate_many(["hole"], [0, 0, 0], PLANS, fps=10, sample_every=50),
    "evaluate": lambda: iphyre_jax.evaluate(policy, "hole", strategy="on-the-fly"),
    "make": lambda: iphyre_jax.make("on-the-fly/hole-v1"),
    "params": lambda: env.params(["hole"]),
    "reset": lambda: env.reset(zero, params),
    "reset_to": lambda: env.reset_to(np.int32(0), params),
    "single_game": lambda: env.single_game(params, 0),
    "step": lambda: env.step(zero, state, 0, params),
    "info": lambda: env.info(state, params),
    "observe": lambda: env.observe(state, params),
    "Batch.of": lambda: Batch.of(env, params, [0]),
    "unroll": lambda: unroll(env, act, (), batch, zero, decisions=1),
    "record": lambda: record(iphyre_jax.load_scene("hole"), [-1], fps=10),
    "IPHYRE": lambda: IPHYRE("hole").reset(),
}
for name, call in calls.items():
    print(name, end=": ", flush=True)
    if status := forked(call):
        print("status", status, flush=True)
print(subprocess.run(["true"], check=True, preexec_fn=lambda: None).returncode)
print(iphyre_jax.simulate("hole", PLANS, fps=10).steps.tolist())
"""
)

UNUSED = (
    PRELUDE
    + """
forked(lambda: print(iphyre_jax.simulate("hole", PLANS, fps=10).steps.tolist()))
print(iphyre_jax.simulate("hole", PLANS, fps=10).steps.tolist())
"""
)


def said_by(code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_a_child_forked_after_use_is_told_to_spawn() -> None:
    *said, idle, parent = said_by(USED)
    assert len(said) == 15
    for line in said:
        name, _, error = line.partition(": ")
        assert error.startswith("iphyre_jax: this process was forked from one that had already used it"), line
        assert 'multiprocessing.get_context("spawn")' in error, name
    assert idle == "0"
    assert parent.startswith("[")


@pytest.mark.slow
def test_a_child_forked_before_use_plays() -> None:
    child, _, parent = said_by(UNUSED)
    assert child == parent
