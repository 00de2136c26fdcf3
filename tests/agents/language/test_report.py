"""The report: whose games its columns hold, and what it tells of replies."""

from __future__ import annotations

import numpy as np

from iphyre_jax.agents.language import report
from iphyre_jax.agents.language.agent import Asked
from iphyre_jax.agents.language.report import Scores
from iphyre_jax.agents.language.runs import Ended, rows_of
from iphyre_jax.agents.language.settings import RunSettings
from iphyre_jax.attempts.protocol import Attempts
from iphyre_jax.scenes import GAMES, SPLITS

BASIC = SPLITS["basic"]
MORE = (*BASIC, SPLITS["noisy"][0])


def test_games_outside_a_whole_split_have_a_column() -> None:
    assert list(report.columns(RunSettings(BASIC))) == ["basic"]
    assert list(report.columns(RunSettings(GAMES)))[-1] == "all"
    assert report.columns(RunSettings(MORE)) == {"basic": BASIC, "all played": MORE}
    assert report.columns(RunSettings(("hole",))) == {"all played": ("hole",)}


def test_one_game_has_no_interval() -> None:
    scores = Scores(np.full((1, 1, 1), 374.2), np.ones((1, 1, 1), bool))
    table = report.split_table(RunSettings(("hole",), attempts=1), {"model": scores})
    assert "| model, first attempt | 374.2 [-], 100 % [-] |" in table


def test_people_stand_beside_the_splits_alone() -> None:
    settings = RunSettings(MORE, attempts=1)
    scores = Scores(np.zeros((len(MORE), 1, 1)), np.zeros((len(MORE), 1, 1), bool))
    header, _, _, people = report.split_table(settings, {"model": scores}).splitlines()
    assert header == "| agent | Basic | all played |"
    assert people == "| people, best of 5 (paper) | 898.0, 92 % | - |"


def test_replies_that_were_cut_off_are_told() -> None:
    settings = RunSettings(("hole",), attempts=1)
    one = np.zeros((1, 1, 1))
    played = Attempts(("hole",), one > 0, one, one.astype(int), one + 15, 0)
    asked = Asked(questions=3, unread=2, cut_off=2, times=np.full(4, np.nan))
    rows = rows_of(settings, Ended((played,), ({("hole", 1): asked},)))
    assert "| replies cut off at the limit of tokens | 2 |" in report.reading_table(rows)
