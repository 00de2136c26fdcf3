"""The official class's calls, against the reference engine and numbers that the official package gave."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax import load_scene
from iphyre_jax.compat import GAMES, IPHYRE, MAX_ELI_OBJ_NUM, MAX_OBJ_NUM, PARAS, generate_actions
from iphyre_jax.observations.official import object_rows, scene_features
from parity.engines.reference import ReferenceWorld


def test_names_of_the_games_module() -> None:
    assert len(GAMES) == 40
    assert (MAX_OBJ_NUM, MAX_ELI_OBJ_NUM) == (12, 6)
    assert PARAS["spring"]["spring"] == [[5, 6]]
    assert "joint" not in PARAS["spring"]
    assert PARAS["support"]["ball"] == [[250.0, 340.0, 20.0]]


def test_steps_follow_the_reference() -> None:
    """Click by click, through a second reset, in a game with a spring that goes with its block."""
    scene = load_scene("spring")
    features = scene_features(scene)
    simulator = IPHYRE("spring", fps=10)
    simulator.reset()
    clicks = simulator.get_action_space()
    assert clicks[0] == [0.0, 0.0]
    assert clicks[1:3] == [[360.0, 200.0], [210.0, 100.0]]
    assert len(clicks) == 7
    world = ReferenceWorld(scene, resets=2)
    for step in range(25):
        block = {5: 4, 12: 5}.get(step)
        click = [0.0, 0.0] if block is None else clicks[block - 3]
        if block is not None:
            world.eliminate(block)
        world.space.step(0.1)
        table, reward, done = simulator.step(np.array(click))
        there, pose = features.present.copy(), np.zeros((12, 3))
        there[:7] &= world.alive
        pose[:7] = np.nan_to_num(world.poses())
        np.testing.assert_allclose(table, object_rows(features, pose[:, :2], pose[:, 2], there), rtol=0, atol=1e-6)
        assert done == world.solved()
        assert reward == pytest.approx(-0.1 - 10 * (block is not None) + 1000 * done)
    assert simulator.step(clicks[1])[1] == pytest.approx(-0.1 + 1000 * simulator.step([0, 0])[2])  # nothing is there


def test_clicks_hit_within_ends_and_ten_px() -> None:
    """Support's lower block lies from (200, 500) to (300, 500)."""
    hits = {(200.5, 500): True, (200, 500): False, (250, 509.9): True, (250, 510): False, (299.9, 490.1): True}
    simulator = IPHYRE("support")
    for click, hit in hits.items():
        simulator.reset()
        assert bool(simulator.removals([[*click, 1.0]])) == hit
    assert not simulator.removals([[250, 500, 0.0]])  # at 0 s a click has no effect


# (times, solved, blocks removed, seconds) of generate_actions("support", 2, 2, 0.1, 15.0, 7.0, 6) of iphyre 0.2.3 with
# pymunk 6.11.1 and NumPy 1.26.
SUPPORT: tuple[list[list[float]], list[list[float]], int] = (
    [
        [4.9, 5.300000000000001, 0.0, 0.0, 0.0, 0.0, 1, 2, 7.0833333333333135],
        [0.5, 3.3000000000000003, 0.0, 0.0, 0.0, 0.0, 1, 2, 4.949999999999988],
    ],
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 15.000000000000325],
        [0.0, 6.800000000000001, 0.0, 0.0, 0.0, 0.0, 0, 1, 15.000000000000325],
    ],
    9,
)


def test_actions_are_the_official_ones() -> None:
    succeeded, failed, drawn = generate_actions("support", 2, 2, 0.1, 15.0, 7.0, 6)
    assert drawn == SUPPORT[2]
    np.testing.assert_allclose(succeeded, SUPPORT[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(failed, SUPPORT[1], rtol=0, atol=1e-12)
    solved = SUPPORT[0][0]
    simulator = IPHYRE("support")
    positions = simulator.get_action_space()
    result = simulator.simulate([[*positions[k + 1], solved[k]] for k in range(6)])
    np.testing.assert_allclose(result, solved[6:], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_collected_files(tmp_path: Path) -> None:
    simulator = IPHYRE("support")
    positions = simulator.get_action_space()
    simulator.collect_initial_data(str(tmp_path / "initial"))
    start = np.load(tmp_path / "initial" / "support" / "vectors.npy")
    np.testing.assert_array_equal(start, simulator.get_all_property())
    assert np.load(tmp_path / "initial" / "support" / "raw.npz")["eli"].tolist() == [1, 1, 0]
    assert (tmp_path / "initial" / "support" / "support.jpg").stat().st_size > 1000

    clicks = [[*positions[1], 0.1], [*positions[2], 0.3]]
    simulator.collect_seq_data(str(tmp_path / "sequences"), [clicks, []], images=False)
    folder = tmp_path / "sequences" / "support"
    vectors = np.load(folder / "0" / "vectors.npy")
    assert vectors.shape == (150, 12, 9)
    np.testing.assert_array_equal(vectors[0], start)
    # At 60 steps a second the click of 0.1 s comes before step 7, that of 0.3 s before step 18, the state at 0.3 s.
    assert [bool(vectors[k, 0].any()) for k in (1, 2)] == [True, False]
    assert [bool(vectors[k, 1].any()) for k in (2, 3, 4)] == [True, False, False]
    ends = np.flatnonzero(~vectors.any(axis=(1, 2)))[0]
    assert vectors[ends - 1, 2, 1] <= 600
    assert not vectors[ends:].any()
    np.testing.assert_array_equal(np.load(folder / "0" / "actions.npy"), clicks)
    assert np.load(folder / "1" / "vectors.npy")[149].any()


BAD: dict[str, tuple[Any, str]] = {
    "game": (lambda: IPHYRE("suport"), "did you mean support"),
    "fps": (lambda: IPHYRE("support", fps=0), "fps: expected a positive number"),
    "no reset": (lambda: IPHYRE("support").step([0, 0]), "support: expected a call of reset first"),
    "one number": (lambda: _ready().step([1]), "pos: expected a position"),
    "text": (lambda: _ready().step("ab"), "pos: expected a position"),
    "none": (lambda: _ready().step(None), "pos: expected a position"),
    "click": (lambda: _ready().simulate([[1, 2]]), "action: expected clicks x, y, t"),
    "nan": (lambda: _ready().simulate([[1, 2, float("nan")]]), "action: expected times that are not negative"),
    "rate": (lambda: _ready().collect_seq_data("/nowhere", fps=7), "fps: expected a divisor of the simulator's 60"),
    "times": (lambda: generate_actions("support", 1, 1, 0.1, 5.0, 7.0, 6), "max_action_time: expected seconds"),
    "slots": (lambda: generate_actions("hole", 1, 1, 0.1, 15.0, 7.0, 3), "max_step: expected at least the 4 blocks"),
    "interval": (lambda: generate_actions("hole", 1, 1, 5.0, 15.0, 7.0, 6), "interval: expected at least 4 instants"),
}


@pytest.mark.parametrize("name", ["play", "simulate_vis", "collect_while_play"])
def test_what_opens_a_window_says_what_does_not(name: str) -> None:
    with pytest.raises(NotImplementedError, match=f"^{name}: expected a window, .*; use [a-z]") as caught:
        getattr(IPHYRE("support"), name)()
    assert "\n" not in str(caught.value)


def _ready() -> IPHYRE:
    simulator = IPHYRE("support")
    simulator.reset()
    return simulator


@pytest.mark.parametrize("case", BAD)
def test_bad_calls_get_one_line(case: str) -> None:
    call, message = BAD[case]
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_plans_that_run_out_are_an_error_and_no_endless_search() -> None:
    """With two instants and two blocks there are two orders; the search for a third went on for ever."""
    with pytest.raises(ValueError, match=r"^interval: expected more instants, because all plans were drawn, [0-9]+ of"):
        generate_actions("support", 0, 10**6, 8, 15, 15, 2)
