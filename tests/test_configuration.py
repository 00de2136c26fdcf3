"""`configure`: options, devices and cache of a process. Each case has a process of its own, JAX being set up once."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import iphyre_jax
from iphyre_jax import compiler_options
from iphyre_jax.private_folder import private_folder

OURS = compiler_options.flag(compiler_options.OPTIONS)
PLAY = """
scene = iphyre_jax.load_scene("hole")
played = iphyre_jax.simulate(scene, [[-1, -1, 20, 30], [3, -1, 9, -1]], fps=10)
result = [played.success.tolist(), played.steps.tolist(), played.reward.tolist()]
"""
START = "import jax.numpy\njax.numpy.zeros(1)\n"
WATCH = 'with warnings.catch_warnings(record=True, action="always") as seen:\n    '
COMMAND = """
import contextlib, io
from iphyre_jax import cli
with contextlib.redirect_stdout(io.StringIO()):
    result = cli.run(["simulate", "support", "--fps", "10"])
"""


@pytest.fixture(scope="module")
def verdict(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file with this jaxlib's verdict, so that not every case has to find it."""
    folder = tmp_path_factory.mktemp("verdict")
    assert compiler_options.accepted(compiler_options.OPTIONS, folder)
    return (folder / compiler_options.VERDICTS).read_text()


@pytest.fixture
def cache(tmp_path: Path, verdict: str) -> Path:
    folder = private_folder(tmp_path / "iphyre_jax")
    (folder / compiler_options.VERDICTS).write_text(verdict)
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


def test_it_sets_options_threads_and_cache_and_changes_no_result(cache: Path) -> None:
    """The cache is used: a second process finds what the first has compiled."""
    code = f"made = iphyre_jax.configure()\n{PLAY}\nresult += [made.threads, str(made.cache), made.xla_flags]"
    *first, threads, folder, flags = python(code, cache)
    assert first == python(PLAY, cache)
    assert flags == OURS
    assert threads == len(os.sched_getaffinity(0))
    assert folder == str(cache)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    compiled = {file.name for file in cache.glob("jit_*-cache")}
    assert compiled
    *second, _, _, _ = python(code, cache)
    assert second == first
    assert {file.name for file in cache.glob("jit_*-cache")} == compiled


def test_import_sets_nothing(cache: Path) -> None:
    code = (
        'import jax\niphyre_jax.configure\nresult = [os.environ.get("XLA_FLAGS"), jax.config.jax_compilation_cache_dir]'
    )
    assert python(code, cache) == [None, None]


def test_what_the_user_has_set_stays(cache: Path, tmp_path: Path) -> None:
    name, *others = compiler_options.OPTIONS
    theirs = f"--xla_cpu_enable_fast_math=false {compiler_options.FLAG}{name}=0"
    own = str(tmp_path / "own")
    code = "made = iphyre_jax.configure()\nresult = [made.xla_flags, str(made.cache)]"
    flags, folder = python(code, cache, {"XLA_FLAGS": theirs, "JAX_COMPILATION_CACHE_DIR": own})
    rest = {other: compiler_options.OPTIONS[other] for other in others}
    assert flags == f"{theirs} {compiler_options.flag(rest)}"
    assert folder == own


def test_it_may_be_called_again(cache: Path) -> None:
    code = f"iphyre_jax.configure()\n{START}made = iphyre_jax.configure(cache=False)\n"
    assert python(code + "result = [made.xla_flags, made.cache]", cache) == [OURS, None]


def test_devices(cache: Path) -> None:
    code = "import jax\nmade = iphyre_jax.configure(devices=3, cache=False, options=False)\n"
    assert python(code + "result = [made.threads, jax.local_device_count(), made.xla_flags]", cache) == [3, 3, ""]
    flags = "--xla_force_host_platform_device_count=2"
    assert python(code + "result = jax.local_device_count()", cache, {"XLA_FLAGS": flags}) == 2


@pytest.mark.parametrize("switch", ["cache=False", "IPHYRE_JAX_CACHE"])
def test_without_a_cache_nothing_is_written(cache: Path, switch: str) -> None:
    (cache / compiler_options.VERDICTS).unlink()
    argument, environment = (switch, {}) if "=" in switch else ("", {switch: "off"})
    code = f"made = iphyre_jax.configure({argument})\n{PLAY}\nresult = [made.cache, made.xla_flags]"
    assert python(code, cache, environment) == [None, OURS]
    assert list(cache.iterdir()) == []


def test_the_variable_names_a_folder(cache: Path, tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "other"
    code = "result = str(iphyre_jax.configure(options=False).cache)"
    assert python(code, cache, {"IPHYRE_JAX_CACHE": str(folder)}) == str(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_one_warning_if_jax_has_started(cache: Path) -> None:
    code = f"{START}{WATCH}made = iphyre_jax.configure(devices=2)\n"
    messages, flags, threads, folder = python(
        code + "result = [[str(w.message) for w in seen], made.xla_flags, made.threads, str(made.cache)]", cache
    )
    assert len(messages) == 1
    assert "JAX has started already, without the compiler options; steps may take several times as long" in messages[0]
    assert "jax.shard_map can use 1 CPU device, not 2" in messages[0]
    assert (flags, threads, folder) == ("", 2, str(cache))


def test_options_that_the_compiler_refuses_are_left_out(cache: Path) -> None:
    (cache / compiler_options.VERDICTS).unlink()
    code = """
from iphyre_jax import compiler_options
compiler_options.OPTIONS = {"-no-such-option-of-llvm": "1"}
with warnings.catch_warnings(record=True, action="always") as seen:
    flags = [iphyre_jax.configure().xla_flags, iphyre_jax.configure().xla_flags]
import jax
result = [[str(w.message) for w in seen], flags, float(jax.jit(lambda x: x + 1)(1.0))]
"""
    messages, flags, two = python(code, cache)
    assert messages == ["configure: this jaxlib refuses the compiler options; steps may take several times as long"] * 2
    assert (flags, two) == (["", ""], 2.0)
    assert list(json.loads((cache / compiler_options.VERDICTS).read_text()).values()) == [False]


def test_a_default_folder_that_cannot_be_used_is_a_warning(cache: Path) -> None:
    cache.chmod(0o777)
    code = f"{WATCH}made = iphyre_jax.configure(options=False)\n"
    messages, folder = python(code + "result = [[str(w.message) for w in seen], made.cache]", cache)
    assert messages == [f"configure: no compilation cache (cache: others may write {cache}; expected mode 0700)"]
    assert folder is None


@pytest.mark.parametrize("devices", [0, -1, 1.5, "2", True])
def test_wrong_devices(devices: Any) -> None:
    with pytest.raises(ValueError, match=r"^devices: expected a whole number of at least 1, got [^\n]*$"):
        iphyre_jax.configure(devices=devices)


def test_wrong_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"^cache: expected a folder, True, False or None, got 3$"):
        iphyre_jax.configure(cache=3)  # type: ignore[arg-type]
    for path in (tmp_path / "file", tmp_path / "file" / "folder"):
        with pytest.raises(ValueError, match=r"^cache: cannot use [^\n]*$"):
            iphyre_jax.configure(cache=path)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(ValueError, match=r"^cache: [^\n]* belongs to another user$"):
        iphyre_jax.configure(cache=tmp_path)


def test_the_command_line_configures(cache: Path) -> None:
    """A plan's command leaves compiled programs in the cache, unless it is told not to."""
    assert python(COMMAND, cache, {"IPHYRE_JAX_CONFIGURE": "off"}) == 0
    assert not list(cache.glob("jit_*-cache"))
    assert python(COMMAND, cache) == 0
    assert list(cache.glob("jit_*-cache"))


def test_a_broken_list_of_verdicts_is_none(tmp_path: Path) -> None:
    (tmp_path / compiler_options.VERDICTS).write_text("[1")
    assert compiler_options.accepted({"xla_cpu_use_multi_output_fusion": "true"}, tmp_path)
    assert list(json.loads((tmp_path / compiler_options.VERDICTS).read_text()).values()) == [True]
