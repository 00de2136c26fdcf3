"""The paper's claims, each with a figure, an interval and a judgement, worked out from data anew.

Verdicts: "holds", "does not hold", "partly", "open" (the data for it is not there).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from iphyre_jax.analyses.difficulty import agreement, iterations
from iphyre_jax.analyses.failures import sources
from iphyre_jax.analyses.figures import COLUMNS, by_split, pearson, share
from iphyre_jax.analyses.people import scores as scores_of_people
from iphyre_jax.analyses.seeds import SAMPLED, unseen_difference
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.intervals import Estimate, bootstrap
from iphyre_jax.kept_rows import Row
from iphyre_jax.paper import paper_numbers
from iphyre_jax.scenes import GAMES
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.compare import Row as Seeds
from iphyre_jax.train.reports.compare import difference
from iphyre_jax.train.reports.report import markdown_table
from iphyre_jax.train.reports.statistics import Summary

NEAR: Final = 50.0  # points between means that count as near, or as even
TESTED: Final = 1000  # sequences of a split on which the paper's classifiers are scored
NOT_PUBLISHED: Final = "no figures are published beside the picture"


class Claim(NamedTuple):
    """A claim of the text and what the data says."""

    text: str
    figure: str
    judgement: str


def claims(
    policies: Sequence[Policy],
    seeds: Mapping[str, Seeds],
    oracle: Mapping[str, Row],
    difficulty: Mapping[str, Row] | None,
) -> list[Claim]:
    """Return all claims.

    Args:
        policies: the shipped ones.
        seeds: all seeds of each agent, see `analyses.seeds`.
        oracle: rows at 10 steps a second, the rate of the policies of the paper's kind.
        difficulty: rows of all forty games at 60, seed 0; None if they are not there.
    """
    return [
        *_strategies(seeds),
        *_splits(),
        *_difficulty(difficulty),
        _unseen(seeds),
        _failures([policy for policy in policies if policy.plans_ahead and policy.fps == 10], oracle),
        *_classifiers(),
        Claim("A world model does not help", f"{NOT_PUBLISHED}; ours: results-controllers.md", "open"),
        Claim("Offline learning on the fly does nothing", f"{NOT_PUBLISHED}; ours: sequence.md", "open"),
        _language_model(),
    ]


def _strategies(seeds: Mapping[str, Seeds]) -> list[Claim]:
    """In advance against on the fly and combined: sampled reward on basic."""
    found = {
        f"{agent}-{letter}": _estimate(difference(seeds[f"{agent}-i"], seeds[f"{agent}-{letter}"], SAMPLED, "basic"))
        for letter in ("o", "c")
        for agent in ("ppo", "a2c", "sac")
    }
    on_the_fly = {name: each for name, each in found.items() if name.endswith("o")}
    combined = {name: each for name, each in found.items() if name.endswith("c")}
    better = sum(each.low > 0 for each in on_the_fly.values())
    near = sum(abs(each.value) < NEAR for each in combined.values())
    return [
        Claim(
            "In advance learns better than on the fly (reward after training, basic, sampled, 10 fps, over seeds)",
            "in advance minus on the fly: " + _listed(on_the_fly),
            _of_all(better, len(on_the_fly)),
        ),
        Claim(
            f"Combined ends near in advance (within {NEAR:g} points, as above)",
            "in advance minus combined: " + _listed(combined),
            _of_all(near, len(combined)),
        ),
    ]


def _estimate(found: Summary | None) -> Estimate:
    """A mean over seeds; unknown if agents share none."""
    return found.estimate if found else Estimate(np.nan, np.nan, np.nan)


def _listed(found: Mapping[str, Estimate]) -> str:
    return "; ".join(f"{name} {each}" for name, each in found.items())


def _of_all(hits: int, count: int) -> str:
    """A verdict on a claim about several cases."""
    return "holds" if hits == count else "does not hold" if not hits else f"partly: {hits} of {count}"


def _splits() -> list[Claim]:
    """Correlations of splits over the paper's agents that learn, and people's spread."""
    agents = [scores for name, scores in paper_numbers()["agents"].items() if name not in ("Human", "Oracle", "Random")]
    of_split = {split: [scores[split][0] for scores in agents] for split in PAPER_SPLITS}
    basic = of_split.pop("basic")
    follows = {split: bootstrap(pearson, basic, found) for split, found in of_split.items()}
    noisy = of_split.pop("noisy")
    closer = {
        f"noisy minus {split}": bootstrap(lambda a, b, c: pearson(a, b) - pearson(a, c), basic, noisy, found)
        for split, found in of_split.items()
    }
    people = by_split(scores_of_people())
    means = [people[split] for split in PAPER_SPLITS]
    spread = max(means) - min(means)
    return [
        Claim(
            "Noisy follows basic over agents, compositional and multi-ball do not (a higher correlation than theirs)",
            f"correlation with basic over the paper's {len(agents)} agents that learn: "
            f"{_listed(follows)}; {_listed(closer)}",
            _of_all(sum(each.low > 0 for each in closer.values()), len(closer)),
        ),
        Claim(
            "People are even over splits",
            f"best minus worst split: {spread:.1f} points (even: at most {NEAR:g})",
            "holds" if spread <= NEAR else "does not hold",
        ),
    ]


def _difficulty(rows: Mapping[str, Row] | None) -> list[Claim]:
    """Difficulty by sampling: agreement with people, hardest split, hardest games."""
    texts = (
        "Difficulty by sampling agrees with people (a negative rank correlation)",
        "Compositional games are hardest",
        "seesaw_angle and activated_pendulum are the hardest games",
        "Seesaw games are hard in every split (hardest third of it)",
    )
    if rows is None:
        return [Claim(text, "difficulty was not measured in whole", "open") for text in texts]
    found = agreement(rows)
    counts = {game: iterations(rows[game]) for game in GAMES}
    logs = by_split({game: float(np.log(count)) for game, count in counts.items()})
    splits = {split: float(np.exp(logs[split])) for split in PAPER_SPLITS}
    hardest = sorted(GAMES, key=lambda game: -counts[game])[:2]
    places = {
        game: sorted(COLUMNS[split], key=lambda each: -counts[each]).index(game) + 1
        for split in splits
        for game in COLUMNS[split]
        if "seesaw" in game
    }
    return [
        Claim(texts[0], f"Spearman of iterations and people's scores: {found}", _holds(found.high < 0)),
        Claim(
            texts[1],
            "geometric mean of iterations, seed 0: "
            + ", ".join(f"{split} {value:.0f}" for split, value in splits.items()),
            _holds(max(splits, key=lambda split: splits[split]) == "compositional"),
        ),
        Claim(
            texts[2],
            ", ".join(f"{game} {counts[game]:,}" for game in hardest),
            _holds(set(hardest) == {"seesaw_angle", "activated_pendulum"}),
        ),
        Claim(
            texts[3],
            "place within its split, of 10: " + ", ".join(f"{game} {place}" for game, place in places.items()),
            _of_all(sum(place <= 3 for place in places.values()), len(places)),
        ),
    ]


def _holds(holds: bool) -> str:
    return "holds" if holds else "does not hold"


def _unseen(seeds: Mapping[str, Seeds]) -> Claim:
    """Unseen basic against basic, the paper's agents and ours."""
    pairs = {name: pair for name, pair in paper_numbers()["unseen_basic"].items() if name != "Random"}
    stated = {name: pair["unseen"] - pair["basic"] for name, pair in pairs.items()}
    near = sum(change > -NEAR for change in stated.values())
    ours = {name: _estimate(unseen_difference(seeds[name])) for name in ("ppo-i", "ppo-i-objects", "ppo-i-smooth")}
    figures = ", ".join(f"{name} {change:.0f}" for name, change in stated.items())
    return Claim(
        f"Unseen basic nearly matches basic (a loss below {NEAR:g} points)",
        f"unseen minus basic, paper: {figures}; ours, greedy: {_listed(ours)}",
        _of_all(near, len(stated)),
    )


def _failures(policies: Sequence[Policy], oracle: Mapping[str, Row]) -> Claim:
    """Failures on basic: timing only, as the paper says?"""
    counts = [sources(policy, COLUMNS["basic"], oracle) for policy in policies]
    timing = sum(count["timing"] for count in counts)
    others = sum(count["order"] + count["selection"] for count in counts)
    impossible = sum(count["impossible"] for count in counts)
    found = share(timing, timing + others)
    text = "All failures on basic are of timing, none of order (greedy plans, feasible orders, 10 fps)"
    figure = f"timing {timing}, order or selection {others}, impossible {impossible}"
    if not timing + others:
        return Claim(text, figure, "open")
    return Claim(
        text,
        f"{figure}: {100 * found.value:.0f} % {found.bounds(scale=100)}",
        _holds(not others),
    )


def _classifiers() -> list[Claim]:
    """The paper's outcome classifiers against chance, and vision against the rest."""
    stated = paper_numbers()["classifiers"]
    new = {
        f"{name} {split}": each for name, scores in stated.items() for split, each in zip(COLUMNS, scores, strict=False)
    }
    new = {name: each for name, each in new.items() if not name.endswith(" basic")}
    found = {name: share(round(value * TESTED / 100), TESTED) for name, value in new.items()}
    above = sum(each.low > 0.5 for each in found.values())
    lowest, highest = min(new.values()), max(new.values())
    vision, plain = (
        share(round(stated[name][3] * TESTED / 100), TESTED) for name in ("Vision Fusion", "Global Fusion")
    )
    gap = vision.value - plain.value
    half = 1.96 * float(np.sqrt(sum(each.value * (1 - each.value) / TESTED for each in (vision, plain))))
    return [
        Claim(
            "Outcome classifiers are no better than chance on new splits",
            f"paper: {lowest} to {highest} % of {TESTED}; above 50 % by their 95 % interval: {above} of {len(found)}, "
            "if plays of one game were independent; they are of ten games",
            "open" if above else "holds",
        ),
        Claim(
            "Vision helps with several balls",
            f"paper: {100 * gap:.1f} points [{100 * (gap - half):.1f}, {100 * (gap + half):.1f}] over Global Fusion, "
            "one seed",
            "holds" if gap > half else "does not hold: within noise",
        ),
    ]


def _language_model() -> Claim:
    """Two solved games cannot give three means above zero."""
    means = dict(zip(PAPER_SPLITS, paper_numbers()["language_model"], strict=True))
    positive = [split for split, mean in means.items() if mean > 0]
    return Claim(
        "The language model solves support and noisy_support only",
        f"mean reward above 0, which needs a solved game: {', '.join(positive)}",
        _holds(set(positive) <= {"basic", "noisy"}),
    )


def document(found: Sequence[Claim]) -> str:
    """Return the document."""
    cells = [[claim.text, claim.figure, claim.judgement] for claim in found]
    return (
        "\n\n".join(
            [
                "# Claims of the paper",
                "Written by `iphyre-jax analyse claims`. In brackets: 95 % intervals; t over the seeds of our agents, "
                "else bootstrap over games or agents, Wilson for shares. Figures of the paper are single runs. A "
                "verdict is a rule applied to the figure, stated in the claim.",
                markdown_table(["claim", "figure", "verdict"], cells),
            ]
        )
        + "\n"
    )
