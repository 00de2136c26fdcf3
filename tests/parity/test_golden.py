"""Every game against plays of pymunk that are kept as files; only the last test needs pymunk."""

import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec

import numpy as np
import pytest

from iphyre_jax import GAMES, SPLITS, load_scene
from parity import golden
from parity.reports.summary import summarise
from parity.tolerances import GOLDEN_IDENTICAL


def test_there_is_a_file_of_every_game_and_no_other() -> None:
    assert sorted(path.stem for path in golden.FOLDER.iterdir()) == sorted(GAMES)
    assert sum(path.stat().st_size for path in golden.FOLDER.iterdir()) < 1.5e6


def test_the_splits_hold_every_game() -> None:
    assert sorted(GAMES) == sorted(name for split, names in SPLITS.items() if split != "unseen_basic" for name in names)


# Splits that share compiled programs are compared in one test, so that one process compiles each of them once. All but
# the first are compiled with few optimisations: `make parity` plays all games as users do.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("splits", "quick"), [(("basic", "noisy"), False), (("compositional",), True), (("multi_ball",), True)]
)
def test_every_game_follows_its_golden_file(
    splits: tuple[str, ...], quick: bool, quickly: Callable[[], AbstractContextManager[None]]
) -> None:
    with quickly() if quick else nullcontext():
        comparisons = {
            (name, plays.fps): golden.compare(load_scene(name), plays)
            for name in (name for split in splits for name in SPLITS[split])
            for plays in golden.read(load_scene(name))
        }
    for fps in golden.EVERY:
        row = summarise(f"{fps} fps", [c for (_, rate), c in comparisons.items() if rate == fps])
        errors = {name: c.error.tolist() for (name, rate), c in comparisons.items() if rate == fps and c.error.any()}
        assert (row.same_flag, row.same_step, row.same_bookkeeping, row.within(1e-6)) == (1.0, 1.0, 1.0, 1.0), errors
        assert row.identical >= GOLDEN_IDENTICAL, errors


NO_PYMUNK = """
import sys
sys.modules["pymunk"] = None  # importing it raises ImportError
from iphyre_jax import load_scene
from parity import golden
scene = load_scene("support")
for plays in golden.read(scene):
    assert golden.compare(scene, plays).same_step.all()
print("compared")
"""


@pytest.mark.slow
def test_golden_files_need_no_pymunk() -> None:
    done = subprocess.run([sys.executable, "-c", NO_PYMUNK], capture_output=True, text=True, check=False)
    assert done.stdout == "compared\n", done.stderr


@pytest.mark.skipif(find_spec("pymunk") is None, reason="pymunk is not installed")
def test_pymunk_still_plays_as_in_the_golden_files() -> None:
    for name in GAMES:
        scene = load_scene(name)
        for kept, now in zip(golden.read(scene), golden.record(scene), strict=True):
            np.testing.assert_array_equal(kept.eliminate_at, now.eliminate_at)
            for one, other in zip(kept.plays, now.plays, strict=True):
                assert (one.success, one.steps, one.eliminations) == (other.success, other.steps, other.eliminations)
                np.testing.assert_array_equal(one.samples, other.samples)
