"""A plan as it is played beside how a model imagines it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import plan_to_steps, simulate
from iphyre_jax.cli import main as cli
from iphyre_jax.models.world import roll_outs, storage
from iphyre_jax.scenes import load_scene

PLAN = (np.nan, np.nan, 1.38, 0.54)  # solves hole


@pytest.fixture(scope="module")
def found() -> roll_outs.RollOut:
    return roll_outs.roll_out_plan(storage.load_model("objects-unlimited"), load_scene("hole"), PLAN)


@pytest.mark.slow
def test_the_real_one_is_what_the_simulator_plays(found: roll_outs.RollOut) -> None:
    scene = load_scene("hole")
    played = simulate(scene, plan_to_steps(np.array([PLAN]), 60, "simulate"), fps=60, dtype="float64", sample_every=1)
    assert played.samples is not None
    assert found.real.success
    frame = 20
    sample = np.asarray(played.samples[0, 6 * (frame - 1) + 1])
    there = ~np.isnan(sample)  # removed blocks stand where they were
    np.testing.assert_allclose(found.real.poses[frame][there], sample[there], atol=1e-9)
    assert found.real.fps == 10
    assert (len(found.real.poses) - 1) * 6 >= played.steps[0] - 1
    # Frame k is the world after 1 + 6 (k - 1) steps: a block is there in the last frame before its removal.
    assert found.real.plan == (-1, -1, 14, 6)
    assert [1 + 6 * (frame - 1) <= step < 1 + 6 * frame for frame, step in ((14, 83), (6, 33))] == [True, True]


@pytest.mark.slow
def test_the_model_is_nearer_than_the_bounds(found: roll_outs.RollOut) -> None:
    assert found.imagined.success
    second = {name: values[10] for name, values in found.error.items()}
    assert second["model"] < 2.0
    assert second["model"] < second["free fall until contact"] < second["nothing moves"]
    assert all(values[0] == 0 for values in found.error.values())
    ball = load_scene("hole").n_blocks
    assert np.ptp(found.imagined.poses[:, ball, 2]) > 0.5  # it rolls
    np.testing.assert_array_equal(found.imagined.poses[:, :ball, 2], 0)  # bars rest


def test_the_film_and_the_picture_of_errors_are_two_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = str(tmp_path / "same.png")
    assert cli.run(["world", "film", "hole", "--plan", "1", "1", "1", "1", "-o", same, "--errors", same]) == 2
    assert capsys.readouterr().err.startswith("iphyre-jax: errors: expected another file than out, got")


@pytest.mark.slow
def test_a_page_and_a_picture_of_the_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, errors = tmp_path / "hole.html", tmp_path / "errors.png"
    plan = ["never", "never", "1.38", "0.54"]
    assert cli.run(["world", "film", "hole", "--plan", *plan, "-o", str(page), "--errors", str(errors)]) == 0
    assert "simulator solved, objects-unlimited solved" in capsys.readouterr().out
    assert "imagined by objects-unlimited" in page.read_text()
    assert errors.read_bytes().startswith(b"\x89PNG")
