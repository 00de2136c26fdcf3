"""What classifiers see: rows of objects, times at the rows of their blocks, and nothing of the outcome."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays import audit, inputs
from iphyre_jax.models.outcome.settings import OutcomeConfig, settings
from iphyre_jax.observations.official import start_observation
from iphyre_jax.scenes import load_scene
from tests.models.outcome.made_up import made_up

PAPER, CLEAN = settings("paper"), settings("clean")


def test_times_stand_at_the_rows_of_their_blocks() -> None:
    scene = load_scene("hinder")  # blocks 1, 2 and 3 of four can be removed
    times = np.array([[1.5, np.nan, 0.0, np.nan, np.nan, np.nan]], np.float32)
    plans = inputs.plan_inputs([scene], np.zeros(1, np.int32), times, PAPER)
    assert plans.seconds[0].tolist() == [0, 1.5] + [0] * 10
    scaled = inputs.plan_inputs([scene], np.zeros(1, np.int32), times, CLEAN)
    assert scaled.seconds[0, 1] == np.float32(0.1)
    assert scaled.removed[0].tolist() == [0, 1] + [0] * 10  # 0 s is never, by the official rule


def test_rows_are_the_official_ones_before_clipping() -> None:
    scene = load_scene("pendulum")
    rows = inputs.scene_rows([scene])[0]
    official = start_observation(scene)[:108].reshape(12, 9)
    np.testing.assert_array_equal(rows.clip(0, 1), official)


@pytest.mark.parametrize("preset", ["relations", "ranker"])
def test_pictures_are_not_mirrored(preset: Any) -> None:
    with pytest.raises(ValueError, match=rf"^network: expected another than vision with {preset}, which mirrors"):
        settings(preset, "vision")
    with pytest.raises(ValueError, match=r"^width: expected at least 4, the heads of attention, got 3$"):
        dataclasses.replace(settings(preset), width=3).check()


def test_pictures_show_the_start() -> None:
    config = settings("paper", "vision")
    pictures = inputs.scene_inputs([load_scene("support"), load_scene("pendulum")], config).pictures
    assert pictures.shape == (2, inputs.PICTURE, inputs.PICTURE, 3)
    ball = np.asarray(pictures[0, int(340 / 600 * inputs.PICTURE), int(250 / 600 * inputs.PICTURE)])
    assert ball[0] > 0.9  # red
    assert ball[1] < 0.2
    assert pictures[0, 0, 0].tolist() == [1, 1, 1]


def test_official_files_leave_out_times_after_the_end() -> None:
    plays = made_up(40, 0)
    late = plays.success & (np.nan_to_num(plays.times, nan=0.0) > 5.0).any(axis=1)
    assert late.any()
    masked, whole = inputs.examples(plays, PAPER).plans, inputs.examples(plays, CLEAN).plans
    assert np.asarray(masked.seconds)[late].max() <= 5.0
    assert (np.asarray(whole.seconds)[late].max(axis=1) * 15 > 5.0).all()


def test_games_and_classes_weigh_alike() -> None:
    game, label = np.array([0, 0, 0, 1, 1], np.int32), np.array([1, 0, 0, 1, 0], np.int32)
    weight = inputs.class_weights(game, label)
    assert weight.tolist() == [1.25, 0.625, 0.625, 1.25, 1.25]


def leaking(plays: Dataset, config: OutcomeConfig) -> inputs.Examples:
    honest = inputs.examples(plays, config)
    seconds = np.array(honest.plans.seconds)
    seconds[:, -1] = plays.success
    return honest._replace(plans=honest.plans._replace(seconds=seconds))


def test_audit_finds_a_planted_label() -> None:
    plays = made_up(40, 0, shuffled=True)
    rows = inputs.scene_rows(plays.scenes)
    assert audit.telling_columns(inputs.examples(plays, CLEAN), rows) == {}
    assert audit.telling_columns(leaking(plays, CLEAN), rows) == {"seconds 11": 1.0}
    assert audit.outcome_dependence(plays, CLEAN) == 0
    assert audit.outcome_dependence(plays, CLEAN, leaking) > 0.3


def test_audit_finds_the_times_that_official_files_leave_out() -> None:
    plays = made_up(40, 0)
    assert audit.outcome_dependence(plays, PAPER) > 0
    assert audit.outcome_dependence(plays, dataclasses.replace(PAPER, masked_times=False)) == 0
