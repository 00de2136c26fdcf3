"""Prompts: what they tell, what the paper's leaves out, and that a changed text has another hash."""

from __future__ import annotations

import numpy as np
import pytest

from iphyre_jax.agents.language import prompts
from iphyre_jax.agents.language.descriptions import (
    describe_attempt,
    describe_scene,
    describe_state,
    object_names,
)
from iphyre_jax.agents.language.pictures import SIZE, after_removals, start
from iphyre_jax.agents.language.prompts import BASES, STRATEGIES, Moment, Prompt, again
from iphyre_jax.agents.language.replies import parse_reply
from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.scenes import Scene, load_scene

PENDULUM = load_scene("pendulum")


def text(prompt: Prompt, scene: Scene = PENDULUM, past: tuple[Attempt, ...] = (), moment: Moment | None = None) -> str:
    return prompt.conversation(scene, past, moment, draw=False)[-1].text


def attempt(poses: np.ndarray | None = None) -> Attempt:
    return Attempt(np.array([0.5, np.nan]), False, -25.0, 1, 15.0, poses)


def test_objects_are_named_as_replies_name_them() -> None:
    told = describe_scene(PENDULUM).splitlines()
    assert told[:3] == [
        "Blocks that you can remove:",
        "index 0: fixed, from (350, 200) to (370, 200), centre (360, 200)",
        "index 1: fixed, from (180, 150) to (240, 150), centre (210, 150)",
    ]
    assert "ball 1: centre (360, 170), radius 20" in told
    assert told[-1] == "index 1 and ball 1: their centres keep their distance"


def test_the_present_state_tells_of_what_moves_or_is_gone() -> None:
    before = PENDULUM.start_poses
    now = before.copy()
    now[-1, :2] += (-3.0, 4.0)
    now[PENDULUM.eliminable_blocks[0]] = np.nan
    assert describe_state(PENDULUM, now, before).splitlines() == [
        "index 0: removed",
        "ball 1: centre (357, 174), radius 20, velocity (-30, 40) px/s",
    ]


def test_a_turned_bar_is_told_by_its_ends() -> None:
    scene = load_scene("seesaw")
    bar = object_names(scene).index("bar D")
    poses = scene.start_poses
    poses[bar, 2] = np.pi
    told = describe_state(scene, poses, poses).splitlines()[0]
    assert told == "bar D: moves, from (470, 250) to (240, 320), centre (355, 285), velocity (0, 0) px/s"


def test_an_attempt_is_told_with_positions_if_asked() -> None:
    poses = np.tile(PENDULUM.start_poses, (151, 1, 1))
    told = describe_attempt(PENDULUM, attempt(poses), 2, positions=True).splitlines()
    assert told[0] == "Attempt 2: asked for index 0 at 0.50 s; not solved after 15.00 s with 1 removed; reward -25.0."
    assert told[1] == "  0.0 s: ball 1 (360, 170)"
    assert len(told) == 1 + 31
    assert len(describe_attempt(PENDULUM, attempt(poses), 2, positions=False).splitlines()) == 1


def test_ours_say_what_the_paper_s_does_not() -> None:
    paper, plain, physics = (text(Prompt(base)) for base in ("paper", "plain", "physics"))
    assert "y from bottom to top" in paper
    assert "y grows DOWNWARDS" in plain
    assert paper.count("[0, 0, 0, 0, 0, 0, 0, 0, 0]") == 12 - PENDULUM.n_objects
    assert "[0, 0, 0," not in plain
    assert "-10 for each removal" in plain
    assert "gravity 100 px/s^2" in physics
    assert "gravity 100" not in plain


@pytest.mark.parametrize("base", BASES[1:])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_the_example_of_each_form_is_read_by_the_parser(base: prompts.Base, strategy: prompts.Strategy) -> None:
    prompt = Prompt(base, strategy)
    parsed = parse_reply(text(prompt), 2, prompt.form)
    assert parsed.problem is None
    assert not parsed.dropped
    assert parsed.removals


def test_earlier_attempts_and_the_moment_are_told_where_asked_for() -> None:
    poses = PENDULUM.start_poses
    moment = Moment(2.5, poses, poses)
    assert "Attempt 1" not in text(Prompt("plain"), past=(attempt(),))
    assert "Attempt 1" in text(Prompt("plain", "in-advance", "outcome"), past=(attempt(),))
    assert "2.50 s have passed" in text(Prompt("plain", "on-the-fly"), moment=moment)
    assert "have passed" not in text(Prompt("plain"), moment=moment)
    later = poses + np.array([0.0, 1.5, 0.0])
    assert "velocity (0, 30) px/s" in text(Prompt("plain", "combined"), moment=Moment(0.05, later, poses, 20.0))


def test_names_and_hashes_differ() -> None:
    every = [Prompt(base, s, f) for base in BASES[1:] for s in STRATEGIES for f in (None, "outcome")]
    assert len({prompt.name for prompt in every}) == len({prompt.hash for prompt in every}) == len(every)
    assert Prompt("plain", "combined", "outcome").name == "plain+combined+outcome"


def test_a_changed_text_changes_the_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    was = Prompt("plain").hash
    assert Prompt("plain").hash == was
    monkeypatch.setattr(prompts, "_RULES", prompts._RULES + " ")
    assert Prompt("plain").hash != was


def test_the_paper_s_prompt_stands_alone() -> None:
    with pytest.raises(ValueError, match=r"^prompt: expected strategy in-advance and no feedback with paper"):
        Prompt("paper", "combined")


def test_a_renewed_question_says_why() -> None:
    conversation = Prompt("plain").conversation(PENDULUM)
    renewed = again(conversation, "hm", "no JSON list of objects was found")
    assert [message.role for message in renewed] == ["system", "user", "assistant", "user"]
    assert "could not be read: no JSON list of objects was found." in renewed[-1].text
    assert renewed[:2] == conversation


def test_an_empty_reply_is_told_in_words() -> None:
    for reply in ("", " \n"):
        assert again([], reply, "nothing")[0].text == "(no text)"


def test_pictures_show_numbers_and_five_moments() -> None:
    pytest.importorskip("PIL")
    import io

    from PIL import Image

    drawn = Image.open(io.BytesIO(start(PENDULUM)))
    assert drawn.size == (SIZE, SIZE)
    assert start(PENDULUM) != start(load_scene("spring"))
    poses = np.tile(PENDULUM.start_poses, (151, 1, 1))
    poses[:, -1, 1] += np.arange(151)
    assert len(set(after_removals(PENDULUM, attempt(poses)))) == 5
    assert len(Prompt("picture").conversation(PENDULUM)[-1].pictures) == 1
    assert len(Prompt("plain", "in-advance", "frames").conversation(PENDULUM, [attempt(poses)])[-1].pictures) == 6
    with pytest.raises(ValueError, match=r"^attempt: expected one with poses"):
        after_removals(PENDULUM, attempt())


@pytest.mark.parametrize("seconds", [1.0, 1.04, 1.06])
def test_a_removed_block_is_in_no_picture_after_it(seconds: float) -> None:
    pytest.importorskip("PIL")
    import io

    from PIL import Image

    hinder = load_scene("hinder")
    poses, never = np.tile(hinder.start_poses, (151, 1, 1)), [np.nan] * (len(hinder.eliminable_blocks) - 1)
    made = Attempt(np.array([seconds, *never]), False, -25.0, 1, 15.0, poses)
    x, y = (hinder.start_poses[hinder.eliminable_blocks[0], :2] * SIZE / 600).round().astype(int)
    for png in after_removals(hinder, made):
        picture = np.asarray(Image.open(io.BytesIO(png)).convert("L"))
        assert picture[y - 8 : y + 9, x - 8 : x + 9].min() == 255
