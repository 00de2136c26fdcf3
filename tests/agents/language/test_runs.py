"""Runs: what is asked, played and scored; faults leave what was answered, and nothing else is scored."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from iphyre_jax.agents.language import agent as agent_module
from iphyre_jax.agents.language import endpoints, runs, transcripts
from iphyre_jax.agents.language.agent import LanguageAgent
from iphyre_jax.agents.language.answers import Live, Replay
from iphyre_jax.agents.language.calls import Answer, CallFailedError, CallSettings
from iphyre_jax.agents.language.descriptions import describe_state
from iphyre_jax.agents.language.prompts import Message, Prompt
from iphyre_jax.agents.language.settings import Caps, RunSettings, most_questions, parameters
from iphyre_jax.agents.language.transcripts import Question
from iphyre_jax.attempts.protocol import Attempt, Attempts
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.simulation import simulate

SUPPORT = load_scene("support")
SETTINGS = RunSettings(games=("support",), attempts=2)
MODEL = {"kind": "openai", "model": "tiny"}
GOOD = '[{"time": 0.1, "index": 0}, {"time": 0.2, "index": 1}]'


class Model:
    """Gives the replies it has, one a call; an exception among them is raised."""

    def __init__(self, *replies: str | Exception) -> None:
        self.replies = list(replies)
        self.heard: list[Sequence[Message]] = []

    def __call__(self, conversation: Sequence[Message], settings: CallSettings) -> Answer:
        self.heard.append(conversation)
        reply = self.replies.pop(0)
        if isinstance(reply, Exception):
            raise reply
        return Answer(reply, "stop", 100, 10)

    def ask(self, question: Question, scene: Scene, conversation: Sequence[Message]) -> Answer:
        return self(conversation, CallSettings())


def agent(model: Model, prompt: Prompt, fps: int = 10) -> LanguageAgent:
    return LanguageAgent(prompt, model.ask, 0, fps, 1)


def plan(model: Model, prompt: Prompt) -> list[float]:
    return agent(model, prompt)(SUPPORT, 1, np.random.default_rng(0), ())[0].round(7).tolist()


def test_a_reply_that_cannot_be_read_is_asked_for_again_three_times_in_all() -> None:
    model = Model("hm", "no [", GOOD)
    assert plan(model, Prompt()) == [0.1, 0.2]
    assert [len(conversation) for conversation in model.heard] == [2, 4, 6]
    model = Model("hm", "no [", "never")
    asking = agent(model, Prompt())
    assert np.isnan(asking(SUPPORT, 1, np.random.default_rng(0), ())).all()
    log = asking.asked["support", 1]
    assert (log.no_answer, log.questions, log.unread, log.tokens_in) == (True, 3, 3, 300)


@pytest.mark.parametrize("strategy", ["in-advance", "combined"])
def test_equal_times_keep_the_order_of_the_reply(strategy: StrategyName) -> None:
    one, other = '{"time": 0.5, "index": 1}', '{"time": %s, "index": 0}'
    replies = [f"[{one}, {other % 0.5}]"] if strategy == "in-advance" else [f"[{one}]", f"[{other % 0}]"]
    asking = agent(Model(*replies), Prompt(strategy=strategy))
    times = asking(SUPPORT, 1, np.random.default_rng(0), ())
    assert plan_to_steps(times, 10, "simulate").tolist() == [[6, 5]]


def test_time_zero_is_the_first_moment() -> None:
    assert plan(Model('[{"time": 0, "index": 1}]'), Prompt()) == pytest.approx([np.nan, 1e-6], nan_ok=True)


class Played:
    """What `simulate` returns of a world in which nothing moves and which is solved after so many steps."""

    def __init__(self, steps: int, duration: float) -> None:
        last = round(duration * 10)
        self.success, self.fault = np.array([steps <= last]), np.zeros(1, int)
        self.steps = np.array([min(steps, last)])
        self.samples = np.zeros((1, last + 1, SUPPORT.n_objects, 3))


@pytest.fixture
def ends_after(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    steps = [151]
    monkeypatch.setattr(agent_module, "simulate", lambda *args, **options: Played(steps[0], options["duration"]))
    return steps


def steps_of(model: Model, strategy: StrategyName, fps: int = 10) -> list[int]:
    times = agent(model, Prompt("plain", strategy), fps)(SUPPORT, 1, np.random.default_rng(0), ())
    steps: list[int] = plan_to_steps(times, fps, "simulate")[0].tolist()
    return steps


@pytest.mark.parametrize("fps", [10, 60])
def test_what_goes_now_goes_at_the_step_of_now(fps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the accumulated clock 8.0 s is just behind step 80, or step 480."""
    still = SimpleNamespace(success=[False], fault=[0], steps=[0], samples=np.zeros((1, 1000, SUPPORT.n_objects, 3)))
    monkeypatch.setattr(agent_module, "simulate", lambda *args, **options: still)
    for moment in range(1, 30):
        replies = ["[]"] * moment + ['[{"index": 1}]'] + ["[]"] * 30
        assert steps_of(Model(*replies), "on-the-fly", fps) == [-1, moment * fps // 2]


@pytest.mark.slow
def test_combined_is_told_where_things_are_now() -> None:
    """A ball that has fallen freely: not where it was at the last tenth of a second."""
    model = Model('[{"time": 0.29, "index": 0}]', "[]")
    agent(model, Prompt("plain", "combined"), 60)(SUPPORT, 1, np.random.default_rng(0), ())
    played = simulate(SUPPORT, [[18, -1]], fps=60, duration=18 / 60, sample_every=1, dtype="float64")
    assert played.samples is not None
    now = describe_state(SUPPORT, *(played.samples[0, step] for step in (18, 12)))
    assert now.splitlines()[0] in model.heard[1][1].text


def test_combined_asks_after_each_removal(ends_after: list[int]) -> None:
    model = Model('[{"time": 2, "index": 1}]', '[{"time": 0.5, "index": 0}]')
    assert steps_of(model, "combined") == [25, 20]
    assert "0.00 s have passed" in model.heard[0][1].text
    assert "index 1: removed" in model.heard[1][1].text
    assert steps_of(Model("[]"), "combined") == [-1, -1]
    again = Model('[{"time": 2, "index": 1}]', '[{"time": 1, "index": 1}]')  # a block that is gone
    assert steps_of(again, "combined") == [-1, 20]
    late = Model('[{"time": 9, "index": 1}]', '[{"time": 9, "index": 0}]')  # after the end
    assert steps_of(late, "combined") == [-1, 90]
    end = Model('[{"time": 9, "index": 1}]', '[{"time": 6, "index": 0}]')  # as in advance
    assert steps_of(end, "combined") == [150, 90]
    at_once = Model('[{"time": 0, "index": 1}]', "[]")
    assert steps_of(at_once, "combined") == [-1, 1]
    assert "index 1: removed" in at_once.heard[1][1].text


@pytest.mark.parametrize(
    ("strategy", "replies", "dropped"),
    [
        ("combined", ['[{"time": 2, "index": 1}]', '[{"time": 1, "index": 1}]'], {"repeated": 1}),
        ("combined", ['[{"time": 9, "index": 1}]', '[{"time": 9, "index": 0}]'], {"time": 1}),
        ("on-the-fly", ['[{"index": 1}]', '[{"index": 1}]', '[{"index": 0}]'], {"repeated": 1}),
    ],
)
def test_entries_of_gone_blocks_and_after_the_end_are_counted(
    ends_after: list[int], strategy: StrategyName, replies: list[str], dropped: dict[str, int]
) -> None:
    asking = agent(Model(*replies), Prompt("plain", strategy))
    asking(SUPPORT, 1, np.random.default_rng(0), ())
    assert asking.asked["support", 1].dropped == dropped


def test_combined_takes_the_next_block_that_is_there(ends_after: list[int]) -> None:
    model = Model('[{"time": 2, "index": 1}]', '[{"time": 1, "index": 1}, {"time": 3, "index": 0}]')
    assert steps_of(model, "combined") == [50, 20]


def test_the_span_of_an_early_velocity_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """An object that moves by 1 px a step of 1/60 s moves at 60 px/s, 0.05 s after the start as after 2 s."""
    line = np.zeros((1, 901, SUPPORT.n_objects, 3))
    line[..., 0] = np.arange(901)[:, None]
    moving = SimpleNamespace(success=[False], fault=[0], steps=[900], samples=line)
    monkeypatch.setattr(agent_module, "simulate", lambda *args, **options: moving)
    model = Model('[{"time": 0.05, "index": 0}]', '[{"time": 2, "index": 1}]')
    agent(model, Prompt("plain", "combined"), 60)(SUPPORT, 1, np.random.default_rng(0), ())
    assert "velocity (60, 0) px/s" in model.heard[1][1].text


def test_on_the_fly_asks_every_half_second_until_the_end(ends_after: list[int]) -> None:
    model = Model("[]", "[]", '[{"index": 1}]', '[{"index": 1}, {"index": 0}]')
    assert steps_of(model, "on-the-fly") == [15, 10]
    ends_after[0] = 12  # solved after 1.2 s
    model = Model(*["[]"] * 9)
    plan(model, Prompt("plain", "on-the-fly"))
    assert len(model.heard) == 3  # at 0, 0.5 and 1 s


def play_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Score plans without physics: a plan that removes both blocks solves the game after 2 s."""

    def attempts(asked: LanguageAgent, k: int, *, games: Sequence[str], fps: int, **options: Any) -> Attempts:
        times = [asked(load_scene(game), k, np.random.default_rng(0), ()) for game in games]
        success = np.array([~np.isnan(plans).any(axis=1) for plans in times])[:, None]
        removed = np.array([(~np.isnan(plans)).sum(axis=1) for plans in times])[:, None]
        seconds = np.where(success, 2.0, 15.0)
        return Attempts(tuple(games), success, 1000.0 * success - 10 * removed - seconds, removed, seconds, 0)

    monkeypatch.setattr(runs, "attempts", attempts)


def live(folder: Path, model: Model, settings: RunSettings = SETTINGS, caps: Caps | None = None) -> list[Any]:
    asked = Live(model, folder / "t.jsonl", MODEL, settings, caps or Caps())
    return runs.rows_of(settings, runs.run(settings, asked))


@pytest.mark.parametrize("faults", [1, 2])
def test_a_failed_call_scores_nothing_and_the_run_goes_on_to_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faults: int
) -> None:
    play_by_hand(monkeypatch)
    model = Model("hm", *[CallFailedError("gone", 500)] * faults, GOOD, "[]")
    for _ in range(faults):
        with pytest.raises(CallFailedError):
            live(tmp_path, model)
        assert [question.number for question in transcripts.read(tmp_path / "t.jsonl")] == [1]
    rows = live(tmp_path, model)
    assert [row["success"] for row in rows] == [True, False]
    assert [row["reward"] for row in rows] == [978.0, -15.0]
    assert rows[0]["questions"] == 2  # the failed call is none
    assert rows[0]["order"] == [0, 1]
    assert live(tmp_path, Model()) == rows  # nothing is asked twice
    replay = Replay(tmp_path / "t.jsonl", SETTINGS)
    assert runs.rows_of(SETTINGS, runs.run(SETTINGS, replay)) == rows
    assert replay.models == ["openai: tiny"]
    assert not replay.handwritten


def test_the_longest_call_fits_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three unreadable replies of emoji, which JSON writes with twelve bytes each, after a hundred attempts."""
    reply = Answer("\U0001f600" * 70_000, "x" * 10_000, None, None)
    monkeypatch.setitem(endpoints.CALLS, "openai", lambda *args: lambda: reply)
    settings = RunSettings(games=("multi_ball_stack",), attempts=100, feedback="trajectory")
    scene = load_scene("multi_ball_stack")
    asked = Live(
        endpoints.Endpoint("openai", "https://a.example", "tiny").complete, tmp_path / "t", MODEL, settings, Caps()
    )
    poses = np.tile(scene.start_poses, (151, 1, 1)) + 0.123
    past = [Attempt(np.full(len(scene.eliminable_blocks), 1.25), False, -25.0, 6, 15.0, poses)] * 99
    agent = LanguageAgent(settings.asked, asked, 0, 60, 1)
    agent(scene, 1, np.random.default_rng(0), past)
    assert agent.asked[scene.name, 100].unread == 3
    assert len(transcripts.read(tmp_path / "t")) == 3


def test_caps_end_a_run_that_goes_on_with_higher_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play_by_hand(monkeypatch)
    model = Model(GOOD, "[]")
    with pytest.raises(ValueError, match=r"^llm: support, .* attempt 2, .* has reached its cap of 1 questions"):
        live(tmp_path, model, caps=Caps(1))
    with pytest.raises(ValueError, match=r"or 50 tokens \(1 and 110\); give more to go on$"):
        live(tmp_path, model, caps=Caps(9, 50))
    assert len(live(tmp_path, model)) == 2


def test_a_replay_names_what_is_missing_or_different(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play_by_hand(monkeypatch)
    live(tmp_path, Model(GOOD, "[]"))
    more = RunSettings(games=("support",), attempts=3)
    with pytest.raises(
        ValueError, match=r"^replay: t.jsonl: expected an answer to support, .* attempt 3, .* got none$"
    ):
        runs.run(more, Replay(tmp_path / "t.jsonl", more))
    other = RunSettings(games=("support",), prompt="physics")
    with pytest.raises(ValueError, match=r"^replay: support, .*: expected the recorded prompt, got another one$"):
        runs.run(other, Replay(tmp_path / "t.jsonl", other))
    with pytest.raises(ValueError, match=r"expected answers of other, got 'tiny'$"):
        Live(Model(), tmp_path / "t.jsonl", {**MODEL, "model": "other"}, SETTINGS, Caps())
    warm = RunSettings(games=("support",), call=CallSettings(temperature=1.7))
    with pytest.raises(ValueError, match=r"expected answers with .'temperature': 1.7, .* got \W+temperature': 0.5, "):
        Live(Model(), tmp_path / "t.jsonl", MODEL, warm, Caps())
    assert Replay(tmp_path / "t.jsonl", warm).parameters == [parameters(SETTINGS.call)]


def test_the_prompt_physics_is_of_its_rate() -> None:
    with pytest.raises(ValueError, match=r"^fps: expected 60 with the prompt physics, which states it, got 10$"):
        RunSettings(games=("support",), prompt="physics", fps=10)


def test_a_folder_holds_one_run(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    runs.check_folder(folder, SETTINGS, MODEL)
    runs.check_folder(folder, SETTINGS, MODEL)
    with pytest.raises(
        ValueError,
        match=r"settings: expected those of this run, got attempts 2, not 3; choose another",
    ):
        runs.check_folder(folder, RunSettings(games=("support",), attempts=3), MODEL)
    with pytest.raises(ValueError, match=r"model: expected those of this run, got model .*, not other; choose"):
        runs.check_folder(folder, SETTINGS, {**MODEL, "model": "other"})
    assert json.loads((folder / "run.json").read_text())["settings"]["prompt"]["hash"] == SETTINGS.asked.hash


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"games": ("nowhere",)}, "games: expected games of the package, got 'nowhere' (iphyre_jax.GAMES lists them)"),
        ({"games": ()}, "games: expected each game once"),
        ({"games": ("support", "support")}, "games: expected each game once"),
        ({"attempts": 0}, "attempts: expected a whole number"),
        ({"samples": 0}, "samples: expected a whole number"),
        ({"fps": 30}, "fps: expected one of 60, 10"),
        ({"prompt": "x"}, "prompt: expected one of"),
        ({"strategy": "x"}, "strategy: expected one of"),
        ({"feedback": "x"}, "feedback: expected one of"),
    ],
)
def test_settings_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        RunSettings(**options)
    assert str(caught.value).startswith(message)


def test_the_most_questions_of_a_run_are_known() -> None:
    assert most_questions(SETTINGS) == 3 * 2
    assert most_questions(RunSettings(("support",), strategy="combined", samples=2)) == 3 * 2 * 2 * 2
    assert most_questions(RunSettings(("support",), strategy="on-the-fly", attempts=1)) == 3 * 30
