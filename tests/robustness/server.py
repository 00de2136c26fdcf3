"""`make test-server`: a hostile hour of the play server, and one player who must notice nothing.

Attackers send what they like to a real `iphyre-jax play`, all at once: wrong tokens, hosts and origins, connections
that dawdle or break, bodies that are too large or too deep, paths out of the folder, bytes that are no HTTP, and, from
a page of the player's own browser, heavy scenes that are valid. In between a player plays games. Each of the player's
requests must be answered rightly within QUICK seconds, each attack must be refused, and each confirmed attempt must be
on file. A late answer does not count if other programs had more than half of the machine while it was awaited.

    python tests/robustness/server.py --minutes 60
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from attacks import QUICK_ATTACKS, Attack, Target, heavy_scene
from record import record

from iphyre_jax import load_scene
from iphyre_jax.viewer import recording
from iphyre_jax.viewer.play.worker import memory_in_use
from iphyre_jax.viewer.plays import iter_plays

FOLDER = Path("build/test-server")
QUICK = 5.0  # s, for an answer to the player on a machine that is under attack
GROWTH = 64e6  # bytes that the server itself may grow; what it plays stands in other processes
PLANS = {"hole": [-1, -1, 83, 32], "support": [20, 90], "fill": [-1] * len(load_scene("fill").eliminable_blocks)}
FOREIGN = 0.5  # share of the machine that other programs may have for an answer to be judged
SLOW = 64  # connections that dawdle at once


def attack(target: Target, attacks: tuple[Attack, ...], seed: int, pause: float) -> None:
    """Attack until the end."""
    rng = random.Random(seed)  # noqa: S311 - nothing secret
    while not target.over:
        one = rng.choice(attacks)
        try:
            fine = one(target, rng)
        except OSError:  # no answer within the time of a client
            fine = False
        target.count(one.__name__, fine)
        time.sleep(rng.uniform(0, pause))


def dawdle(target: Target) -> None:
    """Hold connections that say something now and then, and begin again when they are cut."""
    beginnings = (b"", b"GET /", b"POST /x/api/start HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n")
    held: list[socket.socket] = []
    while not target.over:
        while len(held) < SLOW:
            held.append(socket.create_connection(("127.0.0.1", target.port), 30))
            held[-1].settimeout(0.01)
            held[-1].sendall(beginnings[len(held) % len(beginnings)])
            target.count("dawdle", True)
        time.sleep(0.5)
        for connection in list(held):
            try:
                connection.sendall(b"x")
            except OSError:
                connection.close()
                held.remove(connection)
    for connection in held:
        connection.close()


def busy_seconds() -> tuple[float, float]:
    """Return the processor time, s, that all programs have taken so far, and what this program and its children have.

    The time of children that have ended is in that of their parents.
    """
    total = [int(number) for number in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    parents, times = {}, {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            fields = file.read_text().rpartition(")")[2].split()
            parents[int(file.parent.name)], times[int(file.parent.name)] = int(fields[1]), sum(map(int, fields[11:15]))
    own = {os.getpid()}
    while more := {process for process, parent in parents.items() if parent in own} - own:
        own |= more
    tick = float(os.sysconf("SC_CLK_TCK"))
    return (sum(total) - total[3] - total[4]) / tick, sum(times.get(process, 0) for process in own) / tick


def play(target: Target, slowest: dict[str, float]) -> int:
    """Play until the end; return how many attempts were confirmed."""
    rewards = {game: recording.record(load_scene(game), plan).reward for game, plan in PLANS.items()}
    confirmed, rng = 0, random.Random(1)  # noqa: S311 - nothing secret

    def ask(what: str, act: Callable[[], bool]) -> None:
        begin, (all_before, own_before) = time.monotonic(), busy_seconds()
        try:
            right = act()
        except (OSError, ValueError, KeyError, TypeError):
            right = False
        took = time.monotonic() - begin
        if not right or took > QUICK:
            all_after, own_after = busy_seconds()
            foreign = (all_after - all_before - (own_after - own_before)) / took / (os.cpu_count() or 1)
            answer = f"{'right' if right else 'WRONG'} after {took:.1f} s"
            print(f"player: {what}: {answer}, {foreign:.0%} of the machine was taken by others", flush=True)
            if right and foreign > FOREIGN:
                return
        slowest[what] = max(slowest.get(what, 0.0), took)
        target.count(f"player: {what}", right and took <= QUICK)

    def page_file() -> bool:
        name = rng.choice(["", "play.js", "style.css"])
        head = f"GET /{target.token}/{name} HTTP/1.1\r\nHost: 127.0.0.1:{target.port}\r\n\r\n"
        status, content = target.ask(head.encode())
        return status == 200 and len(content) > 200

    def attempt(game: str) -> bool:
        nonlocal confirmed
        status, answer = target.call("attempt", {"scene": game, "plan": PLANS[game]})
        confirmed += status == 200
        if status == 409:  # five are used: begin again
            return target.call("again", {"scene": game})[1]["standing"]["left"] == 5
        return status == 200 and answer["play"]["reward"] == rewards[game]

    def game_is_right(game: str) -> bool:
        return target.call("game", {"scene": game})[1]["scene"]["name"] == game

    def plan_is_right(game: str) -> bool:
        return target.call("record", {"scene": game, "plan": PLANS[game]})[1]["reward"] == rewards[game]

    while not target.over:
        game = rng.choice(list(PLANS))
        ask("page", page_file)
        ask("game", lambda: game_is_right(game))  # noqa: B023 - called at once
        ask("record", lambda: plan_is_right(game))  # noqa: B023
        ask("attempt", lambda: attempt(game))  # noqa: B023
        time.sleep(rng.uniform(0, 0.5))
    return confirmed


def start_server() -> tuple[subprocess.Popen[str], str]:
    """Start the command as a person does; return its process and the page's address."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    command = [sys.executable, "-u", "-m", "iphyre_jax", "play", "--attempts", str(FOLDER / "attempts.jsonl")]
    with (FOLDER / "stderr.txt").open("w") as errors:
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
    assert server.stdout is not None
    return server, server.stdout.readline().rpartition(" ")[2].strip()


def main() -> int:
    """Attack, play, count; 0 if the player noticed nothing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=60.0)
    minutes = parser.parse_args().minutes
    server, address = start_server()
    try:
        return besiege(server, address, minutes)
    finally:
        server.terminate()
        server.wait(60)


def besiege(server: subprocess.Popen[str], address: str, minutes: float) -> int:
    """Let attackers and a player loose on a server; return the exit code."""
    port, token = address.removeprefix("http://127.0.0.1:").removesuffix("/").split("/")
    target, begin, slowest = Target(int(port), token, 0.0), time.monotonic(), {}
    for game in PLANS:  # the first play of a game may compile
        assert target.call("game", {"scene": game}, 400)[0] == 200
    target.end = time.monotonic() + 60 * minutes
    threads = [threading.Thread(target=attack, args=(target, QUICK_ATTACKS, k, 0.2)) for k in range(4)]
    threads += [threading.Thread(target=attack, args=(target, (heavy_scene,), 100 + k, 5.0)) for k in range(2)]
    threads.append(threading.Thread(target=dawdle, args=(target,)))
    before = memory_in_use(server.pid)
    for thread in threads:
        thread.start()
    confirmed = play(target, slowest)
    for thread in threads:
        thread.join()
    after, alive = memory_in_use(server.pid), server.poll() is None
    saved = sum(1 for _ in iter_plays(FOLDER / "attempts.jsonl"))
    tried, wrong = sum(target.tried.values()), sum(target.wrong.values())
    for what, count in sorted(target.tried.items()):
        print(f"{what}: {count}, wrong {target.wrong[what]}")
    print(f"slowest answers to the player, s: { {what: round(took, 2) for what, took in slowest.items()} }")
    print(f"server: {before / 1e6:.0f} MB, at the end {after / 1e6:.0f} MB, {'alive' if alive else 'DEAD'}")
    lost, fine = max(0, confirmed - saved), alive and after - before < GROWTH
    promise = f"attacked for {minutes:g} minutes the page answers its player rightly and quickly, keeps every attempt"
    record("server-hostile", promise, tried, max(0, tried - wrong - (not fine)), lost, time.monotonic() - begin)
    return 0 if fine and not wrong and not lost else 1


if __name__ == "__main__":
    sys.exit(main())
