"""Part of `make test-faults`: folders and files that cannot be written, and a user without a home. Minutes.

What has to write there is refused in one line that names it, before work is done; what only reads works as ever, and
programs that cannot be kept are compiled all the same. Root may write everywhere, so this program gives that up first.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from record import record as record_check
from rich.console import Console

from iphyre_jax import configure, load_scene, simulate
from iphyre_jax.cli import main as cli
from iphyre_jax.train import loop
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.viewer.plays import append_play, play_to_json
from iphyre_jax.viewer.recording import record

ROOT = Path("build/test-read-only").absolute()
PLAIN = "IPHYRE_JAX_PLAIN_USER"  # set once this program obeys the modes of files
CAPABILITIES = "-dac_override,-dac_read_search,-fowner"
CONFIG = TrainConfig(
    games=("support", "hole"), hidden_sizes=(16,), updates=2, episodes_per_scene=8, learner=PPO(minibatches=2)
)
QUIET = Console(quiet=True)


def obey_modes() -> None:
    """Begin again as a user whom the modes of files bind, if this is root."""
    if os.geteuid() == 0 and not os.environ.get(PLAIN):
        command = ["setpriv", f"--bounding-set={CAPABILITIES}", "--inh-caps=-all", sys.executable, *sys.argv]
        os.execvpe(command[0], command, {**os.environ, PLAIN: "1"})  # noqa: S606 - our own interpreter


def prepare() -> None:
    """Make a folder with a run, half trained, and a file of plays, and take the right to write away."""
    if ROOT.exists():
        os.system(f"chmod -R u+w '{ROOT}'")  # noqa: S605 - our own folder
        shutil.rmtree(ROOT)
    ROOT.mkdir(parents=True)
    loop.train(CONFIG, ROOT / "run", QUIET)
    append_play(ROOT / "plays.jsonl", play_to_json(record(load_scene("hole"), [20], fps=10), "you", {}))
    (ROOT / "empty").mkdir(mode=0o700)
    for path in [ROOT, *ROOT.rglob("*")]:
        path.chmod(path.stat().st_mode & ~0o222)


def run(arguments: list[str]) -> tuple[int, str]:
    """Run a command; return its exit code and what it said on the standard error."""
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
        code = cli.run(arguments)
    return code, said.getvalue()


def refused(path: str, *arguments: str) -> Callable[[], str]:
    """Return a check that a command is refused in one line that names a path."""

    def check() -> str:
        code, said = run(list(arguments))
        return "" if code == cli.ERROR and said.count("\n") == 1 and path in said else f"code {code}, said {said!r}"

    return check


def works(*arguments: str) -> Callable[[], str]:
    """Return a check that a command succeeds and says nothing on the standard error."""

    def check() -> str:
        code, said = run(list(arguments))
        return "" if code == 0 and not said else f"code {code}, said {said!r}"

    return check


def not_kept(folder: Path | None, environment: Mapping[str, str]) -> Callable[[], str]:
    """Return a check that a scene of a new topology is played with one warning that programs are not kept."""

    def check() -> str:
        os.environ.update(environment)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            configure(cache=folder)
            played = simulate("hole", [[20]], fps=10, duration=1, dtype="float64")
        said = [str(warning.message) for warning in caught]
        fine = len(said) == 1 and "compiled programs are not kept (cache: cannot" in said[0]
        return "" if fine and np.isfinite(played.reward).all() else f"said {said}"

    return check


def main() -> int:
    """Try each; 0 if all was as promised."""
    obey_modes()
    begun = time.monotonic()
    prepare()
    at = str(ROOT)
    checks = {
        "a run begins": refused(at, "train", "--games", "hole", "--hidden-sizes", "16", "--out", f"{at}/new"),
        "a run goes on": refused(at, "resume", f"{at}/run"),
        "a run is evaluated": refused(at, "evaluate", f"{at}/run"),
        "a picture": refused(at, "render", "hole", "-o", f"{at}/hole.png"),
        "a page": refused(at, "replay", f"{at}/plays.jsonl", "-o", f"{at}/replay.html"),
        "new attempts": refused(at, "play", "--attempts", f"{at}/new.jsonl"),
        "old attempts": refused(at, "play", "--attempts", f"{at}/plays.jsonl"),
        "plays are scored": works("score", f"{at}/plays.jsonl"),
        "the folder of programs": not_kept(ROOT / "empty", {}),
    }
    survived = 0
    for name, check in checks.items():
        problem = check()
        survived += not problem
        print(f"{name}: {problem or 'as promised'}", flush=True)
    promise = "what cannot be written is refused in one line that names it; what only reads works"
    record_check("read-only", promise, len(checks), survived, 0, time.monotonic() - begun)
    return 0 if survived == len(checks) else 1


if __name__ == "__main__":
    sys.exit(main())
