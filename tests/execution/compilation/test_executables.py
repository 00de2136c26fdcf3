"""How often programs are compiled, in which types, from which threads, and what can go wrong."""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from iphyre_jax import Simulation, simulate, simulate_many
from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation import cache_folder, compiler, description, executables, worker
from iphyre_jax.execution.compilation.cache_folder import machine_of, write_entry
from iphyre_jax.execution.own_process import import_path
from iphyre_jax.execution.programs import Score
from iphyre_jax.scenes import load_scene
from iphyre_jax.scenes.compile import topology_of

pytestmark = pytest.mark.usefixtures("quick_programs")


@pytest.fixture(params=[False, True], ids=["x64 off", "x64 on"])
def flag(request: pytest.FixtureRequest) -> Iterator[bool]:
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", request.param)
    yield request.param
    jax.config.update("jax_enable_x64", before)


def test_one_program_for_a_topology(compiled: list[Any]) -> None:
    """Two scenes, rates, lengths, sizes of batch, numbers of the reset: compiled once, and once more for samples."""
    never = [[-1]]
    simulate("hole", never, fps=10)
    simulate("support", never * 3, fps=60, duration=2)
    simulate("direction", [[0, 1, 2, 3]], fps=25, resets=2)
    simulate_many(["hole", "hinder"], [0, 1, 0], never * 3, fps=60, duration=1)
    assert len(compiled) == 1
    simulate("hole", never * 200, fps=10, duration=3, sample_every=7)
    simulate("support", never, fps=60, duration=1, sample_every=30)
    assert len(compiled) == 2
    simulate("hole", never, fps=10, duration=1, dtype="float64")
    simulate("support", never, fps=60, duration=1, dtype="float64")
    assert len(compiled) == 3


def test_types_do_not_depend_on_the_callers_flag_nor_change_it(flag: bool, compiled: list[Any]) -> None:
    """Both types, compiled and played, with the flag as it was after each."""
    plan = [[20, 5, 30, 9]]
    for dtype in ("float64", "float32"):
        played = simulate("hole", plan, fps=10, dtype=dtype, sample_every=150)
        assert jax.config.jax_enable_x64 == flag
        assert jax.numpy.zeros(()).dtype == ("float64" if flag else "float32")
        assert played.samples is not None
        assert played.samples.dtype == dtype
        assert played.reward.dtype == np.float64
        expected = _ONCE.setdefault(dtype, played)
        np.testing.assert_array_equal(played.samples, expected.samples)
        np.testing.assert_array_equal(played.steps, expected.steps)
    assert len(compiled) == 2


_ONCE: dict[str, Simulation] = {}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_float64_is_more_than_float32_written_wide(dtype: str) -> None:
    played = simulate("hole", [[-1]], fps=60, duration=2, dtype=dtype, sample_every=120)
    assert played.samples is not None
    ball = played.samples[0, -1, -1].astype(np.float64)
    narrow = ball.astype(np.float32).astype(np.float64)
    assert (ball == narrow).all() == (dtype == "float32")


def test_calls_from_threads_give_what_one_thread_gives(compiled: list[Any]) -> None:
    """Eight at once, of both types, none compiled before: each program is still compiled once."""
    plan = np.random.default_rng(0).integers(-1, 80, (8, 40, 4))

    def play(k: int) -> Simulation:
        return simulate("hole", plan[k], fps=10, dtype=("float32", "float64")[k % 2], sample_every=50)

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(play, range(8)))
    assert len(compiled) == 2
    for k, one in enumerate(together):
        alone = play(k)
        np.testing.assert_array_equal(one.steps, alone.steps)
        np.testing.assert_array_equal(one.samples, alone.samples)
        np.testing.assert_array_equal(one.reward, alone.reward)


def test_calls_inside_the_callers_own_contexts() -> None:
    """A caller's x64 context or disabled jit is his own; it neither leaks in nor is left changed."""
    plan = [[20, 5, 30, 9]]
    plain = simulate("hole", plan, fps=10, dtype="float32", sample_every=150)
    with jax.enable_x64(True):
        wide = simulate("hole", plan, fps=10, dtype="float32", sample_every=150)
        assert jax.numpy.zeros(()).dtype == "float64"
    np.testing.assert_array_equal(wide.samples, plain.samples)
    with jax.disable_jit():
        slow = simulate("hole", plan, fps=10, dtype="float32", sample_every=150)
    np.testing.assert_array_equal(slow.samples, plain.samples)


PLAN = [[20, 5, 30, 9], [3, -1, 7, 0]]


def bits(dtype: str = "float32") -> bytes:
    """What a simulation gives, as bytes."""
    played = simulate("hole", PLAN, fps=10, dtype=dtype, sample_every=50)
    assert played.samples is not None
    return b"".join(part.tobytes() for part in (played.success, played.steps, played.reward, played.samples))


def test_an_entry_that_is_not_sound_is_replaced(
    folder: Path, compiled: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut short, or sound as an entry but nothing that can be loaded; `test_cache_folder` has the other faults."""
    expected = bits()
    (entry,) = folder.glob("*.program")
    content = entry.read_bytes()
    header = json.loads(content.splitlines()[1])
    for count, payload in enumerate((None, b"no program"), start=2):
        if payload is None:
            entry.write_bytes(content[: len(content) * 2 // 3])
        else:
            write_entry(entry, header["key"], payload)
        monkeypatch.setattr(executables, "_loaded", {})
        assert bits() == expected
        assert len(compiled) == count
        assert [path.name for path in folder.iterdir()] == [entry.name]
        assert entry.stat().st_mode & 0o777 == 0o600
    monkeypatch.setattr(executables, "_loaded", {})
    assert bits() == expected
    assert len(compiled) == 3  # the last one is sound


def test_an_entry_belongs_to_the_processors_features_and_to_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = Score(topology_of(load_scene("hole")), "float32", 128, 6)
    found = {}
    for flags in ("avx2 avx512f", "avx2"):
        monkeypatch.setattr(cache_folder, "machine", lambda flags=flags: machine_of(f"flags : {flags}"))
        found[flags] = executables._entry(program, tmp_path)[0].name
        assert executables._entry(program, tmp_path / "elsewhere")[0].name == found[flags]
    assert found["avx2"] != found["avx2 avx512f"]


TOGETHER = """
import sys
import iphyre_jax
iphyre_jax.configure(cache=sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
print(iphyre_jax.simulate("hole", [[20, 5, 30, 9], [3, -1, 7, 0]], fps=10).steps.tolist())
"""


@pytest.mark.parametrize("when", ["before", "since"])
def test_a_process_of_other_code_writes_no_entry(when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has changed since a compiling process started, or before it did, is not in the code that it runs."""
    program, path = Score(topology_of(load_scene("hole")), "float32", 128, 6), tmp_path / "entry.program"
    changed = description.source_sums() | {"rules.py": bytes(32)}
    if when == "since":
        monkeypatch.setattr(worker, "source_sums", lambda: changed)
    source = description.sum_of(program.sources, changed if when == "before" else description.source_sums())
    monkeypatch.setattr(worker, "compile_program", lambda program: b"machine code")
    request = {"program": description.describe(program), "path": str(path), "key": {"source": source}}
    answer = worker._answer(json.dumps(request).encode())
    assert answer == {"error": worker.CHANGED}
    assert not path.exists()


@pytest.mark.slow
def test_two_processes_share_one_folder(tmp_path: Path) -> None:
    """They begin at once; both are right, and there is one whole entry."""
    command, pipe = [sys.executable, "-c", TOGETHER, str(tmp_path / "programs")], subprocess.PIPE
    both = [subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) for _ in range(2)]
    for process in both:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    said = [process.communicate("\n", timeout=300) for process in both]
    expected = simulate("hole", PLAN, fps=10).steps.tolist()
    assert [(out, error) for out, error in said] == [(f"{expected}\n", "")] * 2
    (entry,) = (tmp_path / "programs").iterdir()
    key = json.loads(entry.read_bytes().splitlines()[1])["key"]
    assert cache_folder.read_entry(entry, key)


def test_an_idle_compiler_ends_in_silence() -> None:
    code = "import iphyre_jax.execution.compilation.worker as w; w.IDLE_SECONDS = 0.1; w.main()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=-1, stdout=-1, stderr=-1) as process:
        assert process.wait(100) == 0  # its input is still open
        assert (process.stdout or io.BytesIO()).read() == b"{}\n"
        assert (process.stderr or io.BytesIO(b"none")).read() == b""


def test_a_compiler_that_says_something_else_is_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the user's site prints: the plain way works then."""
    (tmp_path / "sitecustomize.py").write_text("print('welcome')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(compiler.CompilationError, match=r"^the compiling process answered 'welcome'$"):
        compiler.CompilerProcess({})


def test_a_compiler_that_refuses_a_program_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    class Refuses:
        is_new = runs = True
        ended = 0

        def compile(self, *_: object) -> None:
            raise compiler.CompilationError("the disk is full")

        def end(self) -> None:
            self.ended += 1

    process = Refuses()
    monkeypatch.setattr(compiler, "_processes", lambda options: iter([process]))
    with pytest.raises(compiler.CompilationError, match=r"^the disk is full$"):
        compiler.compile_all([compiler.Job(b"", Path("x"), {}, {})], lambda *_: None)
    assert process.ended


def test_a_new_process_imports_what_this_one_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    monkeypatch.setattr(sys, "path", ["", Path("/somewhere"), "/there"])  # import skips what is no text
    assert import_path() == os.pathsep.join([str(gone), "/there"])
    gone.rmdir()
    assert import_path() == "/there"


def test_without_a_folder_programs_are_compiled_and_not_kept(
    compiled: list[Any], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = bits()
    monkeypatch.setattr(executables, "_loaded", {})
    monkeypatch.setattr(configuration, "_settings", configuration._Settings(folder_is_known=True))
    assert bits() == expected
    assert len(compiled) == 2
    assert len(list(folder.iterdir())) == 1


def test_compilation_that_takes_too_long_is_ended(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configuration._settings.compile_timeout = 0.05
    with pytest.raises(TimeoutError, match=r"^compiling a program took longer than 0\.05 s$"):
        simulate("multi_ball_lever", [[-1]], fps=10, duration=1)
    assert not list(folder.glob("*.program"))
    configuration._settings.compile_timeout = None
    assert simulate("hole", [[-1]], fps=10, duration=1).steps == [10]


def test_a_claim_of_a_stopped_process_is_not_waited_for_without_end(
    folder: Path, compiled: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = bits()
    (entry,) = folder.glob("*.program")
    entry.unlink()
    monkeypatch.setattr(executables, "_loaded", {})
    monkeypatch.setattr(executables, "PATIENCE", 0.1)
    with cache_folder.claimed(entry):
        assert bits() == expected
    assert len(compiled) == 2


NO_PROCESS = {
    "no process": "no process can be started",
    "unknown option": "the compiling process ended with status",
}


@pytest.mark.parametrize("how", NO_PROCESS)
def test_where_the_way_is_barred_the_plain_one_works(how: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One warning names the cost; the results are right."""
    del folder
    expected = simulate("hole", PLAN, fps=10, duration=1)
    monkeypatch.setattr(executables, "_loaded", {})
    compiler.end_idle()
    if how == "no process":
        monkeypatch.setattr(sys, "executable", "/nowhere/python")
        monkeypatch.setattr(executables, "options_for", lambda lanes: {"another": "key"})
    else:
        monkeypatch.setattr(executables, "options_for", lambda lanes: {"-no-such-option-of-llvm": "1"})
    with pytest.warns(RuntimeWarning, match=f"without compiler options \\({NO_PROCESS[how]}.*3 times as long"):
        played = simulate("hole", PLAN, fps=10, duration=1)
    np.testing.assert_array_equal(played.reward, expected.reward)
    np.testing.assert_array_equal(played.steps, expected.steps)


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of a file's size is Linux's")
def test_where_nothing_can_be_kept_programs_are_compiled_elsewhere(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a compiler process, as fast as ever: in this process steps would take 3 times as long."""
    seen: list[Path] = []

    def compile_all(jobs: list[compiler.Job], show: object) -> None:
        del show
        seen.extend(job.path.parent for job in jobs)
        assert all(path.is_dir() for path in seen)
        raise compiler.CompilationError("seen")

    program = Score(topology_of(load_scene("hole")), "float32", 32, 6)
    monkeypatch.setattr(executables, "compile_all", compile_all)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))  # as on a full disk
    try:
        with pytest.warns(RuntimeWarning, match="programs are") as warned:
            executables.prepare([program])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert f"are not kept (cache: cannot write into {folder}: File too large)" in str(warned[0].message)
    assert seen[0] != folder
    assert not seen[0].exists()


class Terminal(io.StringIO):
    """What people look at."""

    def isatty(self) -> bool:
        return True


def test_people_are_told_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal at once, in one line that is gone afterwards."""
    for terminal, expected in ((Terminal(), "\rcompiling 2 of 3 programs, 0 s"), (io.StringIO(), "")):
        monkeypatch.setattr(sys, "stderr", terminal)
        executables._show(1, 3)
        assert terminal.getvalue() == expected
        executables._clear()
        assert terminal.getvalue().rstrip(" \r") == expected.rstrip()
        assert terminal.getvalue() == "" or terminal.getvalue().endswith(" \r")


def test_without_a_terminal_a_long_compilation_says_so_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, log = [1000.0], io.StringIO()
    monkeypatch.setattr(executables, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(sys, "stderr", log)
    for seconds in (0, 59, 60, 61, 119, 121):
        clock[0] = 1000.0 + seconds
        executables._show(0, 2)
    executables._clear()
    clock[0] += 59  # another compilation begins
    executables._show(0, 1)
    executables._clear()
    lines = log.getvalue().splitlines()
    assert [line.partition(";")[0] for line in lines] == [
        "iphyre_jax: compiling 1 of 2 programs, 60 s",
        "iphyre_jax: compiling 1 of 2 programs, 121 s",
    ]
    assert all("configure(compile_timeout=...)" in line for line in lines)


INTERRUPTED = """
import os, signal, sys, threading, time
import iphyre_jax
iphyre_jax.configure(cache=sys.argv[1])
def interrupt():
    while not any(thread.name.startswith("iphyre_jax_compile") for thread in threading.enumerate()):
        time.sleep(0.05)
    time.sleep(2)
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=interrupt, daemon=True).start()
try:
    iphyre_jax.simulate_many(iphyre_jax.GAMES, range(40), [[-1]] * 40, fps=10)
except KeyboardInterrupt:
    began = time.monotonic()
    played = iphyre_jax.simulate("hole", [[-1]], fps=10, duration=1)
    print(played.steps, time.monotonic() - began < 60)
"""


@pytest.mark.slow
def test_an_interrupt_ends_compilation(tmp_path: Path) -> None:
    """And the next call compiles as ever."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(tmp_path / "programs")], capture_output=True, text=True, timeout=300
    )
    assert done.stdout.split() == ["[10]", "True"], done.stderr
    assert "Traceback" not in done.stderr
