"""`configure`: threads, devices and cache of a process. Each case has a process of its own, JAX being set up once."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import iphyre_jax
from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation.cache_folder import private_folder

PLAY = """
scene = iphyre_jax.load_scene("hole")
played = iphyre_jax.simulate(scene, [[-1, -1, 20, 30], [3, -1, 9, -1]], fps=10)
result = [played.success.tolist(), played.steps.tolist(), played.reward.tolist()]
"""
START = "import jax.numpy\njax.numpy.zeros(1)\n"
# A fast machine compiles it in less than the shortest time that is kept: here every program is.
OWN = """
import jax
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.jit(lambda x: jax.numpy.sort(x) @ x.T)(jax.numpy.ones((64, 64)))
"""
WATCH = 'with warnings.catch_warnings(record=True, action="always") as seen:\n    '
COMMAND = """
import contextlib, io
from iphyre_jax.cli.main import run
with contextlib.redirect_stdout(io.StringIO()):
    result = run(["simulate", "support", "--fps", "10"])
"""


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a process that has played once, and made it."""
    folder = tmp_path_factory.mktemp("home") / "iphyre_jax"
    python(PLAY, folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len(programs(folder)) == 1
    return folder


@pytest.fixture
def cache(tmp_path: Path, known: Path) -> Path:
    """A copy of it, so that not every case has to compile."""
    folder = private_folder(tmp_path / "iphyre_jax")
    for entry in known.glob("*.program"):
        shutil.copy2(entry, folder)
    return folder


def python(code: str, cache: Path, environment: Mapping[str, str] | None = None) -> Any:
    """Run code that sets `result` after the import of iphyre_jax, in a process of its own; return it from JSON."""
    kept = {n: v for n, v in os.environ.items() if n not in ("XLA_FLAGS", "IPHYRE_JAX_CACHE", "IPHYRE_JAX_CONFIGURE")}
    around = {**kept, "XDG_CACHE_HOME": str(cache.parent), **(environment or {})}
    code = f"import json, os, warnings\nimport iphyre_jax\n{code}\nprint(json.dumps(result))"
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, env=around, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def programs(cache: Path) -> dict[str, int]:
    """Programs of ours in a folder, and when each was written."""
    return {file.name: file.stat().st_ino for file in cache.glob("*.program")}


def test_no_call_is_needed_and_configure_changes_no_result(cache: Path) -> None:
    """The cache is used: a second process finds what the first has compiled."""
    found = programs(cache)
    first = python(PLAY, cache)
    code = f"made = iphyre_jax.configure()\n{PLAY}\nresult += [made.threads, str(made.cache)]"
    assert python(code, cache) == [*first, len(os.sched_getaffinity(0)), str(cache)]
    assert programs(cache) == found


def test_nothing_of_the_users_is_set(cache: Path) -> None:
    seen = 'result = [os.environ.get("XLA_FLAGS"), jax.config.jax_compilation_cache_dir]'
    assert python(f"import jax\niphyre_jax.configure\n{PLAY}\n{seen}", cache) == [None, None]
    assert python(f"import jax\niphyre_jax.configure()\n{seen}", cache) == [None, str(cache)]


def test_what_the_user_has_set_stays(cache: Path, tmp_path: Path) -> None:
    """Options of his own compiler, and his own cache for it."""
    theirs, own = "--xla_cpu_enable_fast_math=false", str(tmp_path / "own")
    code = f"import jax\nmade = iphyre_jax.configure()\n{PLAY}\n{OWN}"
    seen = 'result = [os.environ.get("XLA_FLAGS"), jax.config.jax_compilation_cache_dir, str(made.cache)]'
    environment = {"XLA_FLAGS": theirs, "JAX_COMPILATION_CACHE_DIR": own}
    assert python(code + seen, cache, environment) == [theirs, own, str(cache)]
    assert len(programs(cache)) == 1


def test_it_may_be_called_again(cache: Path) -> None:
    code = f"iphyre_jax.configure()\n{START}made = iphyre_jax.configure(cache=False)\n"
    assert python(code + "result = made.cache", cache) is None


def entries_of_jax(cache: Path) -> dict[str, bytes]:
    """What JAX keeps in a folder."""
    return {file.name: file.read_bytes() for file in cache.glob("*.jax")}


def test_the_users_own_programs_are_whole_and_may_move(cache: Path, tmp_path: Path) -> None:
    """A damaged entry is replaced without a word; a copy of the folder elsewhere has every program."""
    code = f"iphyre_jax.configure()\n{OWN}result = None"
    python(code, cache)
    kept = entries_of_jax(cache)
    assert kept
    for name, content in kept.items():
        (cache / name).write_bytes(content[: len(content) // 2])
    python(code, cache)
    mended = entries_of_jax(cache)
    assert mended.keys() == kept.keys()
    assert all(len(mended[name]) > len(kept[name]) // 2 for name in kept)
    elsewhere = tmp_path / "elsewhere" / "iphyre_jax"
    shutil.copytree(cache, elsewhere)
    python(code, elsewhere)
    assert entries_of_jax(elsewhere) == mended
    assert [file.suffix for file in cache.iterdir() if file.name.startswith(".")] == []


def test_devices(cache: Path) -> None:
    code = "import jax\nmade = iphyre_jax.configure(devices=3, cache=False)\n"
    assert python(code + "result = [made.threads, jax.local_device_count()]", cache) == [3, 3]
    flags = "--xla_force_host_platform_device_count=2"
    assert python(code + "result = jax.local_device_count()", cache, {"XLA_FLAGS": flags}) == 2


@pytest.mark.parametrize("switch", ["cache=False", pytest.param("IPHYRE_JAX_CACHE", marks=pytest.mark.further)])
def test_without_a_cache_nothing_is_written(cache: Path, switch: str) -> None:
    shutil.rmtree(cache)
    private_folder(cache)
    argument, environment = (switch, {}) if "=" in switch else ("", {switch: "off"})
    code = f"made = iphyre_jax.configure({argument})\n{PLAY}\nresult = made.cache"
    assert python(code, cache, environment) is None
    assert list(cache.iterdir()) == []


def test_the_variable_names_a_folder(cache: Path, tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "other"
    assert python(PLAY, cache, {"IPHYRE_JAX_CACHE": str(folder)})
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len(programs(folder)) == 1


def test_one_warning_if_jax_has_started(cache: Path) -> None:
    code = f"{START}{WATCH}made = iphyre_jax.configure(devices=2)\n"
    messages, threads = python(code + "result = [[str(w.message) for w in seen], made.threads]", cache)
    assert messages == ["configure: JAX has started with 1 CPU device and keeps them, not 2"]
    assert threads == 2


def test_compiler_options_are_no_longer_set(cache: Path) -> None:
    code = f"{WATCH}iphyre_jax.configure(options=True)\nresult = [w.category.__name__ for w in seen]"
    assert python(code, cache) == ["DeprecationWarning"]


@pytest.mark.parametrize(
    "call",
    ["iphyre_jax.configure()", pytest.param(PLAY.strip().replace("\n", "\n    "), marks=pytest.mark.further)],
    ids=["configure", "simulate"],
)
def test_a_default_folder_that_cannot_be_used_is_a_warning(cache: Path, call: str) -> None:
    shutil.rmtree(cache)
    cache.mkdir()
    cache.chmod(0o777)
    messages = python(f"{WATCH}{call}\nresult = [str(w.message) for w in seen]", cache)
    (message,) = messages
    assert f"compiled programs are not kept (cache: others may write {cache}; expected a folder" in message
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("devices", [0, -1, 1.5, "2", True])
def test_wrong_devices(devices: Any) -> None:
    with pytest.raises(
        ValueError, match=r"^devices: expected a whole number of at least 1 and at most 1024, got [^\n]*$"
    ):
        iphyre_jax.configure(devices=devices)


@pytest.mark.parametrize("seconds", [0, -1.0, "2", True, float("nan")])
def test_wrong_time_limits(seconds: Any) -> None:
    with pytest.raises(
        ValueError, match=r"^compile_timeout: expected None or a positive number of seconds of at most 1000000, got"
    ):
        iphyre_jax.configure(compile_timeout=seconds)


def test_wrong_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"^cache: expected a folder, True, False or None, got 3$"):
        iphyre_jax.configure(cache=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^cache: expected a folder, True, False or None, got ''$"):
        iphyre_jax.configure(cache="")
    for path in (tmp_path / "file", tmp_path / "file" / "folder"):
        with pytest.raises(ValueError, match=r"^cache: cannot use [^\n]*$"):
            iphyre_jax.configure(cache=path)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(ValueError, match=r"^cache: [^\n]* belongs to another user"):
        iphyre_jax.configure(cache=tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="homes are named otherwise")
def test_a_user_without_a_home_plays_without_a_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container with a number for a user."""

    def getpwuid(number: int) -> None:
        raise KeyError(number)

    for name in ("HOME", "XDG_CACHE_HOME", "IPHYRE_JAX_CACHE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", getpwuid)
    monkeypatch.setattr(configuration, "_settings", configuration._Settings())
    with pytest.warns(RuntimeWarning, match=r"are not kept \(cache: cannot use ~/.cache/iphyre_jax: [^\n]*home"):
        assert configuration.cache_folder() is None
    with pytest.raises(ValueError, match=r"^cache: cannot use ~/programs: [^\n]*home"):
        iphyre_jax.configure(cache="~/programs")


def test_the_command_line_configures(cache: Path) -> None:
    """A command gives the cache to JAX too, unless it is told not to."""
    after = "import jax\nresult = [result, jax.config.jax_compilation_cache_dir]"
    assert python(f"{COMMAND}\n{after}", cache, {"IPHYRE_JAX_CONFIGURE": "off"}) == [0, None]
    assert python(f"{COMMAND}\n{after}", cache) == [0, str(cache)]
