"""Training: it learns what can be learned, resumes to the same bits, and ships what it was."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.models.outcome import metrics, runs, storage, training
from iphyre_jax.models.outcome.agent import ranking_agent
from iphyre_jax.models.outcome.settings import OutcomeConfig, settings
from iphyre_jax.models.settings import settings_of
from iphyre_jax.models.storage import METRICS, STATE
from tests.models.outcome.made_up import made_up
from tests.other_options import other_options

QUIET = Console(quiet=True)
CONFIG = dataclasses.replace(settings("clean", "plan"), seeds=2, epochs=20, chunk=10, learning_rate=1e-2)
LEARNED, HELD, JUDGED = made_up(60, 0), made_up(30, 1), made_up(60, 2)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, training.OutcomeState]:
    folder = tmp_path_factory.mktemp("outcome") / "run"
    return folder, runs.train(folder, CONFIG, LEARNED, HELD, QUIET)


def accuracy(state: training.OutcomeState) -> float:
    chances = runs.judge(CONFIG, training.chosen(CONFIG, state), JUDGED)
    assert chances.shape == (2, len(JUDGED))
    return float(np.mean([metrics.scores(JUDGED.game, JUDGED.success, one).accuracy for one in chances]))


@pytest.mark.slow
def test_learns_what_the_plan_decides(trained: tuple[Path, training.OutcomeState]) -> None:
    assert accuracy(trained[1]) > 0.9


def test_shuffled_labels_give_chance(tmp_path: Path) -> None:
    state = runs.train(tmp_path / "run", CONFIG, made_up(60, 0, shuffled=True), HELD, QUIET)
    assert 0.3 < accuracy(state._replace(best=state.params)) < 0.7


def test_resumes_to_the_same_bits_whatever_the_options_of_jax(
    trained: tuple[Path, training.OutcomeState], tmp_path: Path
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    folder = tmp_path / "run"
    with pytest.MonkeyPatch.context() as patched:
        kept = storage.save
        patched.setattr(storage, "save", lambda *given: (kept(*given), interrupt()))
        with pytest.raises(KeyboardInterrupt):
            runs.train(folder, CONFIG, LEARNED, HELD, QUIET)
    assert len((folder / METRICS).read_text().splitlines()) == 1 + CONFIG.chunk
    with other_options():
        resumed = runs.train(folder, CONFIG, LEARNED, HELD, QUIET)
    for one, other in zip(jax.tree.leaves(trained[1]), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (folder / METRICS).read_bytes() == (trained[0] / METRICS).read_bytes()


def test_what_diverged_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def diverged(config: OutcomeConfig, material: Any, first: Any, state: Any) -> tuple[Any, training.History]:
        made = jnp.full((config.chunk, config.seeds), jnp.inf)
        return state, training.History(made, made, made)

    monkeypatch.setattr(runs, "train_chunk", diverged)
    with pytest.raises(ValueError, match=r"training has diverged: after epoch 0 a loss is inf$"):
        runs.train(tmp_path / "run", CONFIG, LEARNED, HELD, QUIET)
    assert not (tmp_path / "run" / STATE).exists()


def test_other_plays_are_refused(trained: tuple[Path, training.OutcomeState]) -> None:
    with pytest.raises(ValueError, match=r"config\.json: plays: expected those of this run"):
        runs.train(trained[0], CONFIG, HELD, HELD, QUIET)
    with pytest.raises(ValueError, match=r"config\.json: held: expected those of this run"):
        runs.train(trained[0], CONFIG, LEARNED, LEARNED, QUIET)


def test_evaluates_ships_and_plays(trained: tuple[Path, training.OutcomeState], tmp_path: Path) -> None:
    folder, state = trained
    judged = {"held-out basic": JUDGED, "unseen_basic": HELD}
    evaluation = runs.evaluate(folder, CONFIG, state, judged, np.full(3, 0.25))
    assert storage.RUNS.read_evaluation(folder)["columns"] == evaluation["columns"]
    assert evaluation["parameters"] == 24 * 256 + 256 + 256 * 2 + 2
    best = runs.best_seed(evaluation)
    storage.FILES.save(tmp_path, runs.shipped(runs.trained(CONFIG, state, evaluation, best)))
    loaded = storage.load_classifier("clean-plan", tmp_path)
    assert loaded.origin["seed"] == best
    before = runs.judge(CONFIG, training.chosen(CONFIG, state), JUDGED)[best]
    np.testing.assert_allclose(runs.judge(loaded.config, loaded.params, JUDGED)[0], before, atol=0.02)
    # As an agent: it believes in removals of the first block before 3.5 s.
    plans = ranking_agent(loaded, 200)("hinder", 5, np.random.default_rng(0))
    assert plans.shape == (5, 3)
    assert (plans[:, 0] < 3.5).all()
    damaged = tmp_path / "clean-plan.npz"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    with pytest.raises(ValueError, match="damaged"):
        storage.load_classifier("clean-plan", tmp_path)


def test_a_list_is_right_if_a_plan_that_solves_comes_first() -> None:
    """By hand; a scene all of whose plans solve, or fail, has nothing to say."""
    score = np.log(np.array([[1.0, 3.0, 4.0], [5.0, 1.0, 2.0], [5.0, 1.0, 2.0], [9.0, 1.0, 2.0]]))
    solves = np.array([[False, True, True], [True, False, False], [False] * 3, [True] * 3])
    found, gradient = jax.value_and_grad(training._listwise_loss)(score, solves)
    assert found == pytest.approx((np.log(8 / 7) + np.log(8 / 5)) / 2)
    assert np.isfinite(gradient).all()
    assert (gradient[:2][solves[:2]] < 0).all()  # a step down makes plans that solve come sooner
    assert (gradient[2:] == 0).all()


def test_files_of_before_lack_later_settings() -> None:
    plain, listed = settings("ranker"), dataclasses.replace(settings("ranker"), listwise=0.5)
    assert not {"listwise", "basic_share"} & set(plain.to_json())
    for config in (plain, listed):
        assert settings_of(OutcomeConfig, config.to_json(), "run") == config
    with pytest.raises(ValueError, match=r"^run: settings: expected basic_share, .*, width, got an object of"):
        settings_of(OutcomeConfig, {k: v for k, v in plain.to_json().items() if k != "width"}, "run")
    with pytest.raises(ValueError, match=r"^listwise: expected a finite number of at least 0, got -1$"):
        dataclasses.replace(plain, listwise=-1).check()
    for network, changes, message in (
        ("vision", {"mirrored": True}, "mirrored: expected False with vision"),
        ("relations", {"time_scale": 15.0}, "time_scale: expected 1 with relations"),
        ("plan", {"basic_share": 0.5}, "basic_share: expected 0 unless plays are drawn from large or generated data"),
        ("plan", {"basic_share": 1.5}, "basic_share: expected a finite number of at least 0 and at most 1, got 1.5"),
        ("plan", {"plans_per_scene": 4, "draws": 10}, "plans_per_scene: expected 1 unless with ranker"),
    ):
        with pytest.raises(ValueError, match=f"^{message}"):
            dataclasses.replace(settings("clean", "plan"), network=network, width=64, **changes).check()


def test_swinging_rate() -> None:
    config = settings("paper")
    rate = training.learning_rate(config, 12_600)
    assert rate(0) == pytest.approx(1e-3)
    assert rate(100) == pytest.approx((1e-3 + 1e-6) / 2)
    assert rate(200) == pytest.approx(1e-6, rel=1e-3)
    assert rate(400) == pytest.approx(1e-3)
    assert rate(12_600) == pytest.approx(1e-6, rel=1e-2)  # the paper's training ends at the bottom
    once = training.learning_rate(settings("clean"), 1000)
    assert once(500) == pytest.approx((1e-3 + 1e-6) / 2)
    assert once(1000) == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", storage.names())
def test_what_ships_loads_and_judges(name: str) -> None:
    loaded = storage.load_classifier(name)
    assert loaded.config.name == name
    assert name in storage.rankers() or 0.5 < loaded.origin["accuracy"]["held-out basic"] < 1
    chances = runs.judge(loaded.config, loaded.params, HELD)
    assert chances.shape == (1, len(HELD))
    assert ((chances >= 0) & (chances <= 1)).all()
    assert chances.std() > 0.01
