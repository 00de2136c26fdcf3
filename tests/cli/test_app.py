"""The command `iphyre-jax`: its output, and one line for every mistake."""

from __future__ import annotations

import builtins
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

import iphyre_jax
from iphyre_jax.cli.main import run
from iphyre_jax.cli.signals import until_signal
from iphyre_jax.files import replacing
from iphyre_jax.scenes.library import ALL_GAMES


def test_games_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["games"]) == 0
    out = capsys.readouterr().out
    for game in ALL_GAMES:
        assert game in out
    assert run(["games", "--split", "multi_ball"]) == 0
    out = capsys.readouterr().out
    assert "multi_ball_lever" in out
    assert "noisy_hole" not in out


def test_a_plan_is_played(capsys: pytest.CaptureFixture[str]) -> None:
    """The best known plan of support at 10 fps: 2.4 s, two removals, a reward of 977.6."""
    plan = ["--plan", "0.1", "0.2", "--fps", "10", "--rule", "in_advance", "--resets", "2"]
    assert run(["simulate", "support", *plan]) == 0
    out = capsys.readouterr().out
    assert "block 0: before step 1 (0.100 s)" in out
    assert "support: solved after 24 steps (2.400 s)" in out
    assert "eliminations: 2" in out
    assert "reward: 977.6" in out


def test_a_time_that_removes_nothing_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "support", "--plan", "20", "0", "--fps", "10"]) == 0
    assert capsys.readouterr().out.count("never, as removals come after 0 s and within 15 s") == 2


def test_missing_and_never_stay(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "support", "--plan", "never", "--fps", "10"]) == 0
    out = capsys.readouterr().out
    assert "block 0: never\n" in out
    assert "block 1: never\n" in out
    assert "support: not solved after 150 steps" in out
    assert "reward: -15.0" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulate", "suport"], "'suport'"),
        (["simulate", "missing.json"], "missing.json"),
        (
            ["simulate", "support", "--plan", "soon"],
            "plan: expected seconds above 0, or never, separated by spaces, got 'soon'",
        ),
        (["simulate", "support", "--plan", "1", "2", "3"], "plan: expected at most 2 times"),
        (["simulate", "support", "--plan", "-1"], "plan: expected seconds above 0"),
        (["simulate", "support", "--plan", "inf"], "plan: expected seconds above 0"),
        (["simulate", "support", "--fps", "25", "--rule", "in_advance"], "fps: expected a multiple of 10"),
        (["simulate", "support", "--resets", "0"], "resets: expected"),
        (["games", "--split", "advanced"], "split: expected one of"),
        (["train", "--fps", "25"], "fps: expected a multiple of 10"),
        (["train", "--split", "advanced"], "split: expected one of"),
        (["train", "--updates", "0"], "updates: expected at least 1"),
        (["train", "--agent", "dqn", "--strategy", "combined"], "agent, strategy: expected one of ppo in-advance"),
        (["train", "--agent", "td3"], "agent, strategy: expected one of ppo in-advance"),
        (["train", "--preset", "best"], "preset: expected one of default, quick, paper, got 'best'"),
        (["evaluate", "no-such-folder"], "no-such-folder: not a run folder"),
        (["verify-pretrained", "no-such-policy"], "name: expected one of a2c-c, a2c-i"),
        (["score", "no-such-file"], "no-such-file: expected a file of plays"),
        (["resume", "no-such-folder"], "no-such-folder: not a run folder"),
        (["compare"], "runs: expected at least one run folder"),
        (["compare", "no-such-folder"], "no-such-folder: not a run folder"),
    ],
)
def test_a_mistake_gets_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = ["--out", str(tmp_path / "run")] if arguments[0] == "train" else []
    assert run([*arguments, *out]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("iphyre-jax: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--nonsense"], "--nonsense"),
        (["train", "--fps", "ten"], "--fps"),
        (["train", "--head", "beta"], "invalid choice 'beta'"),
        (["simulate"], "A game's name or a scene file"),
        (["nonsense"], "train, resume, evaluate, compare, verify-pretrained"),
        ([], "train, resume, evaluate, compare, verify-pretrained"),
    ],
)
def test_a_wrong_option_is_named(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert not printed.out


@pytest.mark.parametrize(
    "command", ["train", "resume", "evaluate", "verify-pretrained", "compare", "simulate", "games", "score"]
)
def test_help_is_no_error(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    assert f"usage: iphyre-jax {command}" in capsys.readouterr().out


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"iphyre-jax {iphyre_jax.__version__}\n"


def test_the_version_may_find_nobody_who_reads() -> None:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-c", "from iphyre_jax.cli.main import main; main()", "--version"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_signal_leaves_no_draft(tmp_path: Path) -> None:
    def work() -> None:
        with replacing(tmp_path / "film.mp4") as draft:
            draft.write_bytes(b"half")
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(9)

    assert until_signal(work) == 143
    assert not list(tmp_path.iterdir())
    assert until_signal(lambda: None) == 0


def test_errors_of_the_system_have_no_number(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["collect", "--verify", "nowhere.npz"]) == 2
    assert capsys.readouterr().err == "iphyre-jax: nowhere.npz: No such file or directory\n"
    scene = tmp_path / "shelves.json"
    scene.touch()
    assert run(["collect", "--verify", str(scene)]) == 2
    expected = f"{scene.with_suffix('.npz')}: expected this file beside shelves.json, there is none"
    assert capsys.readouterr().err == f"iphyre-jax: {expected}\n"


def test_several_errors_are_told_apart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["scene", "check", "none.json", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "; " in said


LIGHT = """
import contextlib, io, sys
from iphyre_jax.cli.main import run
with contextlib.redirect_stdout(io.StringIO()):
    codes = [run(line.split()) for line in ("--help", "games", "scene schema", "simulate -h", "render -h")]
print(codes, sorted({"flax", "optax", "orbax"} & set(sys.modules)))
"""


def test_what_needs_no_agents_loads_none() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert done.stdout == "[0, 0, 0, 0, 0] []\n"


def test_mistakes_name_the_options_of_their_command_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["simulate", "hole", "--fpss", "3"]) == 2
    said = capsys.readouterr().err
    assert "--fps INT" in said
    assert "iphyre-jax simulate --help" in said
    assert "collect" not in said


def test_a_narrow_terminal_has_help(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "5")
    assert run(["simulate", "--help"]) == 0
    assert "plan" in capsys.readouterr().out


def test_the_old_evaluate_of_a_policy_warns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The evaluation itself takes fifty games, so it is replaced."""
    from iphyre_jax.cli import train

    asked: list[object] = []

    def remember(command: object, console: object) -> int:
        asked.append(command)
        return 0

    monkeypatch.setattr(train, "verify_pretrained", remember)
    for command in ("verify-pretrained", "evaluate"):
        assert run([command, "ppo-i"]) == 0
    assert asked[0] == asked[1]
    warning = "FutureWarning: `evaluate ppo-i` is deprecated; use `iphyre-jax verify-pretrained ppo-i`"
    assert capsys.readouterr().err == f"iphyre-jax: {warning}\n"


def test_a_missing_extra_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(("iphyre_jax.cli.app", "tyro"))]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def without_tyro(
        name: str,
        names: Mapping[str, object] | None = None,
        local: Mapping[str, object] | None = None,
        wanted: Sequence[str] | None = (),
        level: int = 0,
    ) -> object:
        if name.partition(".")[0] == "tyro":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, names, local, wanted or (), level)

    monkeypatch.setattr(builtins, "__import__", without_tyro)
    assert run(["games"]) == 2
    message = capsys.readouterr().err
    assert message == (
        "iphyre-jax: this command needs the extra 'train' (tyro is missing): pip install 'iphyre-jax[train]'\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("argument", ["--help", "games"])  # printed by the parser, and by rich
def test_output_that_nobody_reads_is_no_error(argument: str) -> None:
    command = [sys.executable, "-m", "iphyre_jax", argument]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # before the command prints anything
        assert process.stderr.read() == ""
        assert process.wait() == 141


@pytest.mark.slow
def test_python_m_is_the_same_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "iphyre_jax", "games", "--split", "advanced"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("iphyre-jax: split: expected one of")
