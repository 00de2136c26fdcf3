"""Rows of the table of attempts: doing nothing, random plans, planners, shipped models and policies, people."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.analyses.figures import COLUMNS, share
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.analyses.people import success_rates as success_of_people
from iphyre_jax.analyses.shipped import policies, shipped_model
from iphyre_jax.attempts.agents import do_nothing, draw_randomly, improve_best
from iphyre_jax.attempts.fine_tuning import BATCH, LEARNING_RATE, FineTuned
from iphyre_jax.attempts.metrics import auccess, best_reward, solved_curve, solved_curve_of_independent
from iphyre_jax.attempts.planner import REPEATED_PLANS, Planner
from iphyre_jax.attempts.policies import policy_attempts
from iphyre_jax.attempts.protocol import Agent, Attempts, Feedback, attempts
from iphyre_jax.intervals import mean_interval
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.outcome import storage as classifiers
from iphyre_jax.models.outcome.agent import CANDIDATES, ranking_agent
from iphyre_jax.models.outcome.agent import FPS as CLASSIFIED
from iphyre_jax.models.sequence import storage as sequence_models
from iphyre_jax.models.sequence.agent import SequenceTries
from iphyre_jax.models.world import storage as world_models
from iphyre_jax.models.world.imagine import WorldImagination, WorldPlanner
from iphyre_jax.models.world.planning import PLANS
from iphyre_jax.models.world.plays import FPS as IMAGINED
from iphyre_jax.paper import paper_numbers
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.reports.report import TITLES, markdown_table
from iphyre_jax.train.storage.pretrained import load_pretrained, names

MOST: Final = 100  # attempts of random plans and sampled policies
SHOWN: Final = (1, 2, 5, 10, 100)  # attempts of the columns "solved@"
PEOPLE: Final = 5  # attempts that people had
DTYPE: Final = "float64"
SEQUENCED: Final = 60  # steps a second of the plays that the shipped sequence model learned
LEARNING: Final = "ppo-i-objects"  # that learns on the game that it tries
SCRATCH: Final = "from scratch"  # if it knows nothing before

Compute = Callable[[], Attempts]
Specification = tuple[dict[str, Any], Compute]  # settings of a row, and how it is computed


def specifications(fps: int) -> dict[str, Specification]:
    """Return each row's settings and how it is computed, by name."""
    common: dict[str, Any] = {"fps": fps, "resets": RESETS[fps]}
    plain = {**common, "dtype": DTYPE}

    def row(agent: Agent, k: int, runs: int, feedback: Feedback | None = None) -> Specification:
        play = partial(attempts, agent, k, feedback=feedback, runs=runs, **plain)
        return {**plain, "k": k, "runs": runs, "feedback": feedback, "seed": 0}, play

    planners = {}
    for sigma, plans in product((0.0, 1.0, 2.0, 5.0), (100, 300)):
        settings, play = row(Planner(plans, sigma, **common), 5, 2)
        planners[f"planner, {sigma:g} px, {plans} plans"] = {**settings, **REPEATED_PLANS}, play
    found = {
        "do nothing": row(do_nothing, 1, 1),
        "random plans": row(draw_randomly, MOST, 5),
        "improve best, outcomes": row(improve_best, 10, 5, "outcome"),
        "improve best, trajectories": row(improve_best, 10, 5, "trajectory"),
        **planners,
    }
    for name in world_models.names() if fps == IMAGINED else ():
        model = shipped_model("world model", name, world_models.WEIGHTS)
        tried = {**plain, **model, **REPEATED_PLANS, "k": 5, "runs": 2, "plans": PLANS}
        found[f"planner in {name}, {PLANS} plans"] = tried, partial(_world_model, name, 5, 2, plain)
    judges = set(classifiers.names()) - set(classifiers.rankers())  # of random plans; rankers are in carry-over
    for name in sorted(judges) if fps == CLASSIFIED else ():
        judge = shipped_model("classifier", name, classifiers.WEIGHTS)
        tried = {**plain, **judge, "k": 10, "runs": 5, "plans": CANDIDATES}
        found[f"classifier {name}, best of {CANDIDATES}"] = tried, partial(_classifier, name, 10, 5, plain)
    for name in sequence_models.names() if fps == SEQUENCED else ():
        tried = {**plain, **shipped_model("sequence model", name, sequence_models.WEIGHTS), "k": 10, "runs": 5}
        found[f"{name}, greedy first"] = tried, partial(_sequence_model, name, 10, 5, plain)
    learning = {**common, **shipped_model("policy", LEARNING), "k": MOST, "runs": 5, "batch": BATCH}
    for name, pretrained in (("fine-tuned", True), (SCRATCH, False)):
        tried = {**learning, "learning_rate": LEARNING_RATE, "pretrained": pretrained}
        found[f"{LEARNING}, {name}"] = tried, partial(_learning, LEARNING, pretrained, MOST, 5, common)
    for name in names():
        first = {**common, **shipped_model("policy", name), "k": 10, "runs": 5, "greedy_first": True}
        if name.endswith("-o"):
            first["greedy"] = "median of what is left"  # rows by an earlier rule have other settings
        found[f"{name}, greedy first"] = first, partial(_policy, name, 10, 5, common)
    return found


def _world_model(name: str, k: int, runs: int, plain: Mapping[str, Any]) -> Attempts:
    """Attempts of a planner that imagines random plans in a shipped world model."""
    agent = WorldPlanner(WorldImagination(world_models.load_model(name)), PLANS)
    return attempts(agent, k, runs=runs, **plain)


def _classifier(name: str, k: int, runs: int, plain: Mapping[str, Any]) -> Attempts:
    """Attempts of a shipped classifier that judges random plans."""
    return attempts(ranking_agent(classifiers.load_classifier(name)), k, runs=runs, **plain)


def _sequence_model(name: str, k: int, runs: int, plain: Mapping[str, Any]) -> Attempts:
    """Attempts of a shipped sequence model: its greedy plan, then drawn ones."""
    model = sequence_models.load_model(name)
    return attempts(SequenceTries(model.config, model.params), k, runs=runs, **plain)


def _learning(name: str, pretrained: bool, k: int, runs: int, common: Mapping[str, Any]) -> Attempts:
    """Attempts of a shipped policy, or of a new one like it, that learns on the game that it tries."""
    policy = load_pretrained(name)
    return FineTuned(policy.config, policy.state if pretrained else None).attempts(k, runs=runs, **common)


def _policy(name: str, k: int, runs: int, common: Mapping[str, Any]) -> Attempts:
    """Attempts of a shipped policy, the greedy one first."""
    policy = load_pretrained(name)
    return policy_attempts(policy.config, policy.state, k, runs=runs, greedy_first=True, **common)


def file_stem(name: str) -> str:
    """Return the name of a row's file."""
    return name.replace(", ", "-").replace(" ", "-")


def run(folder: Path, fps: int, name: str, specification: Specification) -> Row:
    """Return a row; it is computed if it is missing in `folder`/attempts-<fps>fps."""
    settings, compute = specification
    same = "pretrained" not in settings and not settings.get("feedback")
    return kept_row(folder / f"attempts-{fps}fps", file_stem(name), settings, partial(_row, compute, same))


def _row(compute: Compute, same: bool) -> Row:
    """Curves and best rewards of every game, as JSON values; `same`: all attempts are draws of one distribution."""
    played = compute()
    runs, k = played.success.shape[1:]
    curve, best = solved_curve(played.success), best_reward(played.reward)
    if same and k == MOST:
        curve = solved_curve_of_independent(played.success.sum(axis=(1, 2)), runs * k, k)
        best = best_reward(played.reward.reshape(len(played.games), -1, PEOPLE))
    return {
        "games": list(played.games),
        "solved": {game: curve[row].tolist() for row, game in enumerate(played.games)},
        "best_reward": {game: best[row].tolist() for row, game in enumerate(played.games)},
        "faults": played.faults,
    }


def document(tables: Mapping[int, Mapping[str, Row]], missing: Mapping[int, Sequence[str]]) -> str:
    """Return the document of the rows of each rate."""
    parts = [
        "# Attempts",
        "Written by `iphyre-jax analyse attempts`. AUCCESS@k: area under the share of games solved within 1, ..., k "
        "attempts, weighted as PHYRE does. In brackets: 95 % bootstrap interval over games, "
        f"which is too narrow where nearly all of ten games agree: ten of ten is known to be above "
        f"{100 * share(10, 10).low:.0f} % only (Wilson). Attempts after a success are made too. "
        "Classifiers judge different random plans and play the best; a planner imagines them. "
        "Improve best, outcomes, draws random plans until one solves the game, so that it solves as many as random "
        "plans do; with trajectories it changes until then the attempt whose highest ball came lowest. Planners "
        "imagine each plan in three displaced copies, and have two runs; most others have five. "
        "Shipped policies and the sequence model, each the best of five seeds on the basic games and their unseen "
        "layouts, try their greedy plan first, then sample. Classifiers are the best of five seeds by the outcomes of "
        "held-out plays of these games, the world model of three by those in unseen basic. The policy that is "
        f"fine-tuned learns on the game after its greedy attempt and {BATCH} sampled ones, and after each {BATCH} "
        f"more, so not yet within {BATCH} attempts; beside it one like it that begins from scratch. The hand-written "
        f"replies are no model's: they show that the language-model agent works. Physics: {DTYPE}; of policies: "
        "as they were trained. A policy that was trained at another rate says so. A row of k attempts has no figure "
        "beyond k; one that always repeats itself keeps its first.",
    ]
    rates = {policy.name: policy.fps for policy in policies()}
    for fps, rows in tables.items():
        parts.append(f"## {fps} steps a second, reset {RESETS[fps]}")
        if missing.get(fps):
            parts.append(f"Still missing: {'; '.join(missing[fps])}.")
        if rows:
            titled = {_title(name, fps, rates): row for name, row in rows.items()}
            parts += ["### AUCCESS@5", _auccess_table(titled), "### All forty games", _games_table(titled, fps)]
    return "\n\n".join(parts) + "\n"


def _title(name: str, fps: int, rates: Mapping[str, int]) -> str:
    """The name of a row, with the rate of training, one of `rates`, of a policy that was trained at another one."""
    agent, *how = name.split(", ")
    trained_at = fps if SCRATCH in how else rates.get(agent, fps)  # from scratch it learns at this rate alone
    return name if trained_at == fps else f"{name} (trained at {trained_at} fps)"


def _auccess_table(rows: Mapping[str, Row]) -> str:
    """AUCCESS@5, in %, by split, and over all games at 100."""
    cells = []
    for name, row in rows.items():
        if _attempts(row) >= PEOPLE:
            curves = [[_curve(row, game, PEOPLE) for game in games] for games in COLUMNS.values()]
            cells.append([name, *(_spread([float(auccess(one)) for one in of_split]) for of_split in curves)])
    return markdown_table(["agent", *(TITLES[split] for split in COLUMNS)], cells)


def _games_table(rows: Mapping[str, Row], fps: int) -> str:
    """Solved within k attempts, AUCCESS@100 and best reward after five, over all games."""
    cells = []
    for name, row in rows.items():
        most = _attempts(row)
        solved = [_spread([_curve(row, game, k)[-1] for game in GAMES]) if k <= most else "-" for k in SHOWN]
        wide = _spread([float(auccess(_curve(row, game, MOST))) for game in GAMES]) if most == MOST else "-"
        best = [row["best_reward"][game][:PEOPLE][-1] for game in GAMES]
        cells.append([name, *solved, wide, f"{np.mean(best):.1f}" if most >= PEOPLE else "-"])
    if fps == 60:  # as people played
        people = success_of_people()
        stated = paper_numbers()["agents"]["Human"]["all"]
        cells.append(
            ["people (paper, derived)", "-", "-", _spread(list(people.values())), "-", "-", "-", str(stated[0])]
        )
    header = ["agent", *(f"solved@{k} %" for k in SHOWN), "AUCCESS@100", "best of 5"]
    return markdown_table(header, cells)


def _attempts(row: Row) -> int:
    """The attempts of a row; a single one stands for all, as its agent repeats it."""
    length = len(row["solved"][GAMES[0]])
    return MOST if length == 1 else length


def _curve(row: Row, game: str, k: int) -> list[float]:
    """The share solved within 1, ..., k; a single attempt stands for all, as its agent repeats it."""
    curve: list[float] = row["solved"][game]
    return (curve * k if len(curve) == 1 else curve)[:k]


def _spread(values: Sequence[float]) -> str:
    """A mean in % with its interval over games."""
    found = mean_interval(values)
    return f"{100 * found.value:.1f} {found.bounds(scale=100)}"
