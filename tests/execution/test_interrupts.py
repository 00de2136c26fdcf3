"""Ctrl-C while a compiled program calls the host: the main thread cannot see it, the callbacks can."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import jax
import pytest

from iphyre_jax.cli.signals import interrupting
from iphyre_jax.execution import interrupts


def signalled(meanwhile: Callable[[], object], number: int = signal.SIGINT) -> bool:
    """Whether a callback in another thread is interrupted, if the file of signals gets a signal `meanwhile`."""
    receiver, sender = socket.socketpair()
    ended, raised = threading.Event(), [threading.Event(), threading.Event()]

    def callbacks(own: threading.Event) -> None:
        while not ended.is_set():
            try:
                interrupts.check()
            except KeyboardInterrupt:
                own.set()
            time.sleep(0.005)

    def interrupt() -> None:
        time.sleep(0.1)
        sender.send(bytes([number]))

    threads = [threading.Thread(target=callbacks, args=(one,)) for one in raised]  # of two programs
    threads.append(threading.Thread(target=interrupt))
    threads.append(threading.Thread(target=interrupts._read, args=(receiver,)))
    for thread in threads:
        thread.start()
    meanwhile()
    ended.set()
    threads[2].join()
    sender.close()
    for thread in threads:
        thread.join()
    receiver.close()
    assert interrupts._state.place is None
    assert raised[0].is_set() == raised[1].is_set()  # whose program the main thread waits for is not known
    return raised[0].is_set()


@pytest.mark.slow
def test_a_main_thread_that_waits_interrupts_the_callbacks() -> None:
    assert signalled(lambda: time.sleep(1.0))


@pytest.mark.slow
def test_signals_that_end_a_command_are_interrupts_while_it_runs() -> None:
    with interrupting():
        assert signalled(lambda: time.sleep(1.0), signal.SIGTERM)
    assert not signalled(lambda: time.sleep(0.6), signal.SIGTERM)


@pytest.mark.slow
@pytest.mark.parametrize("each", [0, 50])
def test_a_main_thread_that_goes_on_has_seen_it_itself(each: int) -> None:
    """Also in a loop so short that it is almost always met in the same place."""

    def works() -> None:
        end, places = time.monotonic() + 1.0, 0
        while time.monotonic() < end:
            places += sum(k * k for k in range(each))

    assert not signalled(works)


@pytest.mark.slow
def test_who_handles_interrupts_himself_is_left_alone() -> None:
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        assert not signalled(lambda: time.sleep(0.6))
    finally:
        signal.signal(signal.SIGINT, before)


def test_without_an_interrupt_nothing_is_raised() -> None:
    interrupts.check()


def test_an_event_loops_own_file_stays() -> None:
    one, other = socket.socketpair()
    one.setblocking(False)
    before = signal.set_wakeup_fd(one.fileno())
    try:
        interrupts.watch()
        assert signal.set_wakeup_fd(-1) == one.fileno()
    finally:
        signal.set_wakeup_fd(before)
        one.close()
        other.close()


@pytest.mark.parametrize("text", ["INTERNAL: Error when calling buffer callback: ... KeyboardInterrupt: ", "no memory"])
def test_what_jax_makes_of_an_interrupt_is_an_interrupt_again(text: str) -> None:
    error = KeyboardInterrupt if "KeyboardInterrupt" in text else jax.errors.JaxRuntimeError
    with pytest.raises(error), interrupts.as_interrupts():
        raise jax.errors.JaxRuntimeError(text)


LONG = """
import os, signal, sys, threading, time
import jax, jax.numpy as jnp, numpy as np
import iphyre_jax
from iphyre_jax.envs.batching.unrolling import Batch, unroll
env, params = iphyre_jax.make("on-the-fly/hole-v1")
batch = Batch.of(env, params, np.zeros(32, int))
keys = jax.random.split(jax.random.key(0), 32)
policy = lambda weights, key, obs: (jnp.zeros((), jnp.int32), ())
@jax.jit
def own(now):
    def decide(now, _):
        return jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, now, jnp.zeros(32, jnp.int32), params)[1], None
    return jax.lax.scan(decide, now, length=10_000_000)  # days
def play(decisions):
    return unroll(env, policy, (), batch, keys[0], decisions=decisions)
jax.block_until_ready(play(2))
sent = []
def interrupt():
    time.sleep(5)
    sent.append(time.monotonic())
    os.kill(os.getpid(), signal.SIGINT)
for long in (lambda: own(batch.state), lambda: play(200_000)):
    threading.Thread(target=interrupt, daemon=True).start()
    try:
        jax.block_until_ready(long())
    except BaseException as error:
        print(type(error).__name__ if "KeyboardInterrupt" in repr(error) else error, flush=True)
        print(time.monotonic() - sent[-1] < 5, flush=True)
jax.block_until_ready(play(2))
print("goes on")
"""


@pytest.mark.slow
def test_an_interrupt_ends_a_program_that_plays() -> None:
    """Within about a second; and the next program plays. In a user's own program it may have JAX's name."""
    done = subprocess.run([sys.executable, "-c", LONG], capture_output=True, text=True, timeout=300)
    own, own_is_fast, *ours = done.stdout.split("\n")
    assert own in ("KeyboardInterrupt", "JaxRuntimeError"), done.stderr
    assert own_is_fast == "True"
    assert ours == ["KeyboardInterrupt", "True", "goes on", ""], done.stderr
