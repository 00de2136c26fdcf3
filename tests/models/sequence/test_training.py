"""Training: it learns what the return decides, resumes to the same bits, and ships what it was."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.models.sequence import agent, runs, storage, training
from iphyre_jax.models.sequence.episodes import SequenceData, episodes
from iphyre_jax.models.sequence.networks import SequenceModel
from iphyre_jax.models.sequence.settings import SequenceConfig, settings
from iphyre_jax.models.settings import settings_of
from iphyre_jax.models.storage import METRICS, STATE
from tests.models.sequence.made_up import made_up
from tests.other_options import other_options

QUIET = Console(quiet=True)
TINY = {"layers": 1, "width": 16, "heads": 2, "seeds": 2, "updates": 60, "chunk": 30, "batch_size": 16}
CONFIG = dataclasses.replace(settings("paper"), **TINY, learning_rate=2e-2, smoothing=0.0)
PLAYS = made_up()
DATA = episodes(PLAYS, CONFIG)
ORIGIN = {"count": 4, "sha256": "0"}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, training.SequenceState]:
    folder = tmp_path_factory.mktemp("sequence") / "run"
    return folder, runs.train(folder, CONFIG, DATA, ORIGIN, QUIET)


def plans(state: training.SequenceState, asked: float) -> np.ndarray:
    params = training.of_seed(state.params, 0)
    return agent.Player(CONFIG, params, PLAYS.scenes, np.array([0, 1]), asked).plans()


@pytest.mark.slow
def test_the_return_decides(trained: tuple[Path, training.SequenceState]) -> None:
    good, bad = plans(trained[1], 0.975), plans(trained[1], -0.02)
    np.testing.assert_allclose(good[:, :3], [[0.5, 2.0, np.nan], [3.0, 1.2, np.nan]], atol=1e-9)
    np.testing.assert_allclose(bad[:, :3], [[np.nan, 1.0, np.nan], [np.nan] * 3], atol=1e-9)


@pytest.mark.slow
def test_resumes_to_the_same_bits_whatever_the_options_of_jax(
    trained: tuple[Path, training.SequenceState], tmp_path: Path
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    folder = tmp_path / "run"
    with pytest.MonkeyPatch.context() as patched:
        kept = storage.save
        patched.setattr(storage, "save", lambda *given: (kept(*given), interrupt()))
        with pytest.raises(KeyboardInterrupt):
            runs.train(folder, CONFIG, DATA, ORIGIN, QUIET)
    assert len((folder / METRICS).read_text().splitlines()) == 1 + 1
    with other_options():
        resumed = runs.train(folder, CONFIG, DATA, ORIGIN, QUIET)
    for one, other in zip(jax.tree.leaves(trained[1]), jax.tree.leaves(resumed), strict=True):
        np.testing.assert_array_equal(one, other)
    assert (folder / METRICS).read_bytes() == (trained[0] / METRICS).read_bytes()
    with pytest.raises(ValueError, match=r"config\.json: plays: expected those of this run"):
        runs.train(folder, CONFIG, DATA, {**ORIGIN, "sha256": "1"}, QUIET)


def test_what_diverged_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def diverged(config: SequenceConfig, arrays: Any, first: Any, state: Any) -> tuple[Any, np.ndarray]:
        return state, np.full((config.chunk, config.seeds), np.nan, np.float32)

    monkeypatch.setattr(runs, "train_chunk", diverged)
    with pytest.raises(ValueError, match=r"training has diverged: after update 0 a loss is nan$"):
        runs.train(tmp_path / "run", CONFIG, DATA, ORIGIN, QUIET)
    assert not (tmp_path / "run" / STATE).exists()


@pytest.mark.further
def test_what_is_not_a_number_stays_in_the_loss(trained: tuple[Path, training.SequenceState]) -> None:
    params = training.of_seed(trained[1].params, 0)
    batch = training.draw(CONFIG, jax.tree.map(jnp.asarray, DATA), jax.random.key(0))
    loss = jax.jit(partial(training.loss, CONFIG))
    assert np.isfinite(loss(params, batch))
    assert np.isnan(loss(jax.tree.map(lambda leaf: leaf * np.nan, params), batch))


def test_ships_what_it_was(trained: tuple[Path, training.SequenceState], tmp_path: Path) -> None:
    params = storage.FILES.rounded(training.of_seed(trained[1].params, 1))
    storage.FILES.save(tmp_path, storage.TrainedSequenceModel(CONFIG.name, CONFIG, params, {"seed": 1}))
    loaded = storage.load_model(CONFIG.name, tmp_path)
    assert loaded.config == dataclasses.replace(CONFIG, seeds=1)
    for one, other in zip(jax.tree.leaves(params), jax.tree.leaves(loaded.params), strict=True):
        np.testing.assert_array_equal(one, other)
    file = tmp_path / f"{CONFIG.name}.npz"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ValueError, match="damaged"):
        storage.load_model(CONFIG.name, tmp_path)


def test_blurred() -> None:
    found = np.asarray(training.blurred(jnp.array([0, 75, 150]), 151, 0.2))
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-5)
    assert found[2, 150] == 1
    assert found[:2, 150].max() == 0
    assert found[1].argmax() == 75
    assert found[1, 73] == pytest.approx(found[1, 75] * np.exp(-0.5), rel=1e-5)  # two tenths are one deviation
    np.testing.assert_array_equal(training.blurred(jnp.array([3]), 151, 0.0)[0], np.eye(151)[3])


@pytest.mark.slow
def test_long_sequences_are_cut() -> None:
    config = dataclasses.replace(settings("paper", "on-the-fly"), context=3, batch_size=64)
    data = episodes(made_up(10, poses=True), config)
    batch = training.draw(config, SequenceData(*map(jnp.asarray, data)), jax.random.key(0))
    assert batch.inputs.returns.shape == (64, 3)
    time = np.asarray(batch.inputs.time)
    np.testing.assert_array_equal(np.diff(time, axis=1), 1)
    assert (np.asarray(batch.weight) > 0).all()  # parts lie before the end of a play
    assert len(set(time[:, 0].tolist())) > 20


@pytest.mark.further
def test_what_cannot_be_chosen_is_not_learned() -> None:
    config = dataclasses.replace(settings("ours"), **TINY)
    data = jax.tree.map(jnp.asarray, episodes(PLAYS, config))
    index = jnp.arange(2)
    batch = training.take(config, data, index, jnp.zeros(2, jnp.int32))
    params = jax.jit(SequenceModel(config).init)(jax.random.key(0), batch.inputs)
    assert float(batch.weight[0].sum()) > 0
    alone = jax.tree.map(lambda leaf: leaf[1:], batch)
    nothing_left = batch.inputs.rows.at[0, :, :, 5].set(0)  # of the first play: no block is there to be removed
    blind = batch._replace(
        inputs=batch.inputs._replace(rows=nothing_left), weight=batch.weight.at[0, :, 1:].set(0).at[0, 1:].set(0)
    )
    loss = jax.jit(partial(training.loss, config))
    np.testing.assert_allclose(loss(params, blind), loss(params, alone), rtol=1e-5)


def test_settings_are_checked() -> None:
    assert settings_of(SequenceConfig, CONFIG.to_json(), "x") == CONFIG
    for field, value, message in (
        ("chunk", 7, "chunk: expected a divisor of 60 updates, got 7"),
        ("heads", 3, "heads: expected a divisor of the width 16, got 3"),
        ("fps", 30, "fps: expected one of 10, 60, got 30"),
        ("solved_share", 1.5, "solved_share: expected a finite number of at least 0 and at most 1"),
        ("solved_share", "x", "solved_share: expected a finite number"),
        ("smoothing", float("nan"), "smoothing: expected a finite number of at least 0"),
        ("weight_decay", -5, "weight_decay: expected a finite number of at least 0"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(CONFIG, **{field: value}).check()
    for preset, field in (("paper", "mirrored"), ("ours", "coded_labels")):
        with pytest.raises(ValueError, match=f"^{field}: expected False where actions are"):
            dataclasses.replace(CONFIG, preset=preset, **{field: True}).check()
