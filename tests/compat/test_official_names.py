"""What official scripts use beside the simulator: added games, lists of the objects that are left, all games."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.compat import GAMES, IPHYRE, PARAS, collect_initial_all, collect_play_all, generate_actions, play_all

# As the official README writes a game of one's own.
MINE = {
    "block": [[[200.0, 400.0], [300.0, 400.0]], [[200.0, 500.0], [300.0, 500.0]]],
    "ball": [[250.0, 340.0, 20.0]],
    "eli": [1, 1, 0],
    "dynamic": [0, 0, 1],
}


@pytest.fixture
def _added() -> Iterator[None]:
    PARAS["mine"] = {**MINE}
    yield
    del PARAS["mine"]


@pytest.mark.usefixtures("_added")
def test_a_game_added_to_paras_is_a_game() -> None:
    """Numbers of iphyre 0.2.3 with pymunk 6.11.1."""
    simulator = IPHYRE("mine")
    positions = simulator.get_action_space()
    assert positions == [[0.0, 0.0], [250.0, 400.0], [250.0, 500.0], *[[0.0, 0.0]] * 4]
    solved, removed, seconds = simulator.simulate([[*positions[1], 0.5], [*positions[2], 0.7]])
    assert (solved, removed) == (1, 2)
    assert seconds == pytest.approx(2.2999999999999967, abs=1e-12)
    assert len(generate_actions("mine", 1, 1, 0.1, 15.0, 7.0, 6)[0][0]) == 9
    PARAS["mine"]["ball"] = np.array([[250.0, 340.0, 25.0]])
    assert IPHYRE("mine").balls == [[250.0, 340.0, 25.0]]


@pytest.mark.usefixtures("_added")
def test_bad_parameters_name_the_game_and_the_field() -> None:
    PARAS["mine"]["eli"] = [1, 1]
    with pytest.raises(ValueError, match=r"^PARAS\['mine'\]: eli: expected"):
        IPHYRE("mine")
    with pytest.raises(ValueError, match="did you mean support"):
        IPHYRE("suport")


def test_a_changed_game_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PARAS, "support", {**PARAS["support"], "ball": [[250.0, 340.0, 15.0]]})
    assert IPHYRE("support").balls == [[250.0, 340.0, 15.0]]


def test_constants_and_lists_before_the_first_reset() -> None:
    """All of them as iphyre 0.2.3 has them."""
    simulator = IPHYRE("multi_ball_pendulum", fps=10)
    assert (simulator.HEIGHT, simulator.WIDTH, simulator.screen) == (600, 600, None)
    assert (simulator.b_mass, simulator.b_elasticity, simulator.b_friction) == (1.0, 0.1, 0.5)
    assert (simulator.l_elasticity, simulator.l_friction) == (0.1, 0.5)
    assert simulator.eli_mask is None
    assert simulator.eli == [0, 0, 0, 0, 1, 1, 1, 1, 0, 0]
    assert simulator.dynamic == [0] * 8 + [1, 1]
    assert simulator.shape == [1] * 8 + [0, 0]
    assert simulator.joint == [[6, 8], [5, 9]]
    assert simulator.spring is None


def test_lists_follow_what_is_removed() -> None:
    """Clicks and lists of iphyre 0.2.3; the spring goes with its block."""
    simulator = IPHYRE("spring")
    positions = simulator.get_action_space()
    assert simulator.spring == [[5, 6]]
    assert [simulator.eliminate(click) for click in (positions[2], positions[2], [0.0, 0.0])] == [5, -1, -1]
    assert (simulator.eli, simulator.spring, simulator.eli_mask) == ([0, 0, 0, 0, 1, 0], [], [0, 1, 2, 3, 4, 6])
    assert simulator.eliminate(positions[1]) == 4
    assert (simulator.eli, simulator.eli_mask) == ([0] * 5, [0, 1, 2, 3, 6])
    assert (simulator.dynamic, simulator.shape) == ([0, 0, 0, 0, 1], [1, 1, 1, 1, 0])
    assert not simulator.get_all_property()[4:6].any()
    assert not simulator.examine_success()
    simulator.reset()
    assert simulator.eli_mask == [0, 1, 2, 3, 4, 5, 6]


def test_success_is_what_step_says() -> None:
    simulator = IPHYRE("support", fps=10)
    positions = simulator.get_action_space()
    simulator.init_screen()  # scripts that want pictures call it; it opens nothing
    assert [simulator.eliminate(click) for click in positions[1:3]] == [0, 0]
    found = []
    for _ in range(40):
        found.append(simulator.step([0, 0])[2])
        assert simulator.examine_success() == found[-1]
    assert found[-1]


def test_attributes_of_other_libraries_say_so() -> None:
    simulator = IPHYRE("support")
    for name in ("space", "clock", "draw_options", "add_ball", "add_all", "get_property", "add_text"):
        with pytest.raises(AttributeError, match=f"^{name}: expected pymunk and pygame, .*; use ") as caught:
            getattr(simulator, name)
        assert "\n" not in str(caught.value)
    with pytest.raises(AttributeError, match=r"^'IPHYRE' object has no attribute 'spce'$"):
        _ = simulator.spce


def test_calls_for_all_games(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("iphyre_jax.compat.all_games.GAMES", ["support"])
    collect_initial_all(f"{tmp_path}/", images=False)
    assert sorted(file.name for file in (tmp_path / "support").iterdir()) == ["raw.npz", "vectors.npy"]
    for call in (play_all, lambda: collect_play_all("me", 5, "plays.json")):
        with pytest.raises(NotImplementedError, match=r"expected a window, .*; use the command iphyre-jax play"):
            call()
    assert len(GAMES) == 40
