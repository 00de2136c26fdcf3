"""The document of `benchmarks.learning.carry_over`, from its rows."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.learning.on_the_fly import runs_in
from iphyre_jax.analyses.figures import COLUMNS
from iphyre_jax.analyses.oracle import RESETS, shipped
from iphyre_jax.analyses.people import scores as scores_of_people
from iphyre_jax.intervals import Estimate, mean_interval
from iphyre_jax.kept_rows import Row
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.reports.report import TITLES, markdown_table
from iphyre_jax.train.reports.statistics import summary

SHOWN: Final = (1, 2, 5, 10)  # tries
INTRO: Final = (
    "Written by `make carry-over`. Policies in advance, float32, reset 2 at 10 steps a second and reset 1 at 60. "
    "Cells: mean over seeds [95 % t interval over seeds]; with one seed the interval is over games or scenes."
)
ABOUT: Final = {
    "default": "the default preset: it learns from the ten basic games, 1,000 variations of each, and, in half of "
    "its episodes, the generated scenes that ship with the package, drawn by learnability. The next five rows differ "
    "from it in one thing",
    "variations": "no generated scenes",
    "generated": "generated scenes alone",
    "small-pool": "1,000 generated scenes",
    "uniform": "all scenes drawn alike",
    "small-network": "two blocks of width 64",
    "large-pool": "19,000 generated scenes and twice the updates",
    "large-batch": "the same scenes, and 240 updates of twice the episodes and of all topologies",
    "ensemble": "four policies of `default` as one, by the product of their distributions; its seeds share no policy",
    "ranked": "the policies of `large-batch`, whose plans a classifier chooses among: the greedy one and 256 samples "
    "at temperature 3 are tried in the order of log chance of success + 0.01 log probability. One classifier a rate "
    "serves all five policies; it learned from random plans of the same scenes",
    "refined": "the same policies, a weight of 0.005, and this classifier after refinements, two at 10 steps a "
    "second and one at 60: each plays those random plans of 20,000 further scenes that it believes in, and learns "
    "from them",
    "refined-default": "that classifier, and policies of the settings and seeds of `default`; at 10 steps a second",
    "confident": "`refined`, but 0.8 times the policy's probability of the greedy plan is added to that plan's score: "
    "a policy that is sure of its plan keeps it",
    "refined-again": "`confident`, and a third refinement of the classifier, whose scenes are 1,000 variations of "
    "each basic game too; at 10 steps a second",
    "pairs": "`refined-again`, but two policies of `large-batch` as one, as in `ensemble`; its seeds share no policy",
    "with-unions": "`confident`, but policies and classifier learn from unions too: 15,000 generated scenes with the "
    "objects of two basic games each. They are among the policies' scenes, and those of a fourth refinement of the "
    "classifier; a fifth has 15,000 others and 1,000 variations of each basic game; at 10 steps a second",
    "on-policy": "policies of the settings and seeds of `with-unions`, and that classifier after two further "
    "refinements, each with 20,000 further generated scenes, 15,000 unions and 1,000 variations of each basic game. "
    "Their plans are not random: the five policies propose them. A second loss, of the plans of a scene as a list, "
    "asks that one that solves it comes first. The greedy plan gains 1.6 times its probability; at 10 steps a second",
    "ppo-i-objects": "the shipped policy, the best of five seeds of `default` on basic and unseen basic games, "
    "trained at 10 steps a second",
    "ppo-i-objects-ranked": "the shipped policy with the shipped classifiers, `ranker-10fps` and `ranker-60fps`, and "
    "the gain of `confident`",
}
CHOSEN_FOR_ALL: Final = (
    "Chosen on what: network, learner, number of updates and size of the pool on held-out generated scenes and "
    "unseen basic games; the pool's share and the numbers of the curriculum were not tuned. The temperature of the "
    "tries, 3, and how far they must differ come from trials on held-out generated scenes in which the forty games "
    "were in view; other rules were compared on held-out scenes since and were no better. Row by row, in order of "
    "time:"
)
CHOSEN: Final = {
    "large-pool": "it got the number of updates of a trial on held-out scenes after `default` at 10 steps a second "
    "had been seen on the forty; nothing else was changed after any of the rows above had been seen",
    "ensemble": "later; how its policies are put together, and how many, was chosen on held-out scenes with "
    "`small-network`",
    "large-batch": "after these. The size of its updates, their topologies, their number and the learning rate were "
    "chosen at 10 steps a second with one seed, on held-out scenes and on 3,000 further generated ones, by people "
    "who had seen the scores of the other rows on the forty",
    "ranked": "after that. The classifier's network, batches and learning rate were chosen at 10 steps a second on "
    "held-out scenes, the number of samples, their temperature and the weight of the policy's probability on 1,000 "
    "further generated scenes, with the policies of two seeds",
    "refined": "by people who had seen all of this. That to refine pays, and the weight, was chosen at 10 steps a "
    "second on 1,000 further generated scenes, variations of the basic games and these themselves, with two policies "
    "of `default`. On held-out scenes `refined` is better than `refined-default`: so it is the one that counts, as "
    "was written down before either was played on the forty",
    "confident": "after `refined` had been played: its first tries lost `fill`, a basic game that the policies "
    "solve. The gain was chosen at 10 steps a second on the basic games, with five policies, and on the generated "
    "scenes and variations, where it costs 2 to 14 points, with three. On unseen basic games and held-out scenes "
    "`confident` is ahead at 10 steps a second. At 60 held-out scenes do not tell the two apart, and on unseen basic "
    "games `refined` is ahead by one game of one seed. Before it, `ppo-i-objects-ranked` was "
    "played without the gain: 668.7 points at the first try at 10 steps a second, 674.0 at 60",
    "refined-again": "after `confident` had been played. A third refinement was planned then; its variations, and that "
    "it is kept, was chosen at 10 steps a second with five policies on 800 other variations of the basic games (741 "
    "points beside 734 of `confident`) and 1,000 further generated scenes (602 and 601). Before it, "
    "`ppo-i-objects-ranked` was played with the classifier refined twice: 634.5 points at the first try",
    "pairs": "with it, on the same scenes: two pairs of policies have 753 and 613 points, where their four policies "
    "alone have 740 and 603. So at 10 steps a second `pairs` was the row that counts, as was written down before "
    "either was played on the forty",
    "with-unions": "after all these. People who had seen the scores by split, where compositional and multi-ball games "
    "lag, drew unions; none of their numbers was tuned. That both refinements are kept was chosen at 10 steps a second "
    "with five policies on 1,000 other unions, 1,000 further generated scenes, the 800 variations and the basic games: "
    "605, 605, 752 and 851 points, with four refinements 578, 607, 747 and 872, with `refined-again` 534 (three "
    "policies), 602, 741 and 871. So at 10 steps a second `with-unions` is the row that counts, as was written down "
    "before it was played on the forty. Before it, `ppo-i-objects-ranked` was played with the classifier refined three "
    "times: 654.4 points at the first try",
    "on-policy": "after all these. That policies propose, and the list, was chosen at 10 steps a second with one "
    "policy on 800 other variations, 1,000 other unions and 1,000 further generated scenes, that both refinements "
    "are kept with three: 761, 651 and 633 points, beside 752, 601 and 609 with five refinements. The gain was "
    "raised because with 0.8 policies lost a basic game in some of four draws; with 1.6 five policies have 872 "
    "points on these, and it costs the other scenes nothing. It was known that on unseen basic games, of which there "
    "are ten, the trial's five lose one more: 734 points, beside 791. So at 10 steps a second `on-policy` is the row "
    "that counts, as was written down before it was played on the forty. Before it, `ppo-i-objects-ranked` was played "
    "with the classifier refined five times: 654.3 points at the first try",
}

Cells = Callable[[Row], Sequence[float]]


def document(
    held_out: Mapping[int, Mapping[str, Row]],
    forty: Mapping[int, Mapping[str, Row]],
    missing: Sequence[str],
    counter: Path,
    facts: Mapping[str, Any],
) -> str:
    """Return the document.

    Args:
        held_out: of each rate, rows of runs, NAME-SEED, and of the shipped policy.
        forty: of each rate, rows of the same names, and "random plans".
        missing: runs that are not there.
        counter: file with the number of runs on the forty games, if there were any.
        facts: provenance.
    """
    parts = [
        "# What carries over",
        INTRO,
        _listed(ABOUT),
        f"Still missing: {'; '.join(missing)}." if missing else "Nothing is missing.",
        "## Unseen basic games and held-out generated scenes, first try",
    ]
    for fps, found in held_out.items():
        if found:
            parts += [f"### {fps} steps a second", _held_out_table(found)]
    if any(forty.values()):
        count = runs_in(counter)
        parts += [
            "## All forty games",
            f"This command has played them {count} time{'s' if count != 1 else ''}, each row once; "
            "`ppo-i-objects-ranked` was played again with each new classifier. First try: the "
            "greedy plan (with a classifier: the first in its order). Then samples at temperature 3 (with a "
            "classifier: the next in its order) that differ from all earlier tries, in a block or in a time by over "
            "0.2 s and over 10 %; five runs of ten tries. People: the paper's, best of five. Best known: the search "
            "of `Oracle`. Nothing here was trained on, or chosen by, the noisy, compositional and multi-ball games.",
            CHOSEN_FOR_ALL,
            _listed(CHOSEN),
        ]
    for fps, found in forty.items():
        if found:
            parts += [f"### {fps} steps a second, reset {RESETS[fps]}", _first_table(found), _best_table(found, fps)]
    parts += ["## Origin", f"```json\n{json.dumps(facts, indent=1)}\n```"]
    return "\n\n".join(parts) + "\n"


def _listed(texts: Mapping[str, str]) -> str:
    """A Markdown list of rows and what is said of them."""
    return "\n".join(f"- `{name}`: {text}." for name, text in texts.items())


def _groups(found: Mapping[str, Row]) -> dict[str, list[Row]]:
    """Rows NAME-SEED by name, in order of the seeds."""
    groups: dict[str, list[Row]] = {}
    for name in sorted(found):
        stem, _, seed = name.rpartition("-")
        groups.setdefault(stem if seed.isdecimal() else name, []).append(found[name])
    return groups


def _cell(group: Sequence[Row], values: Cells, digits: int = 0, scale: float = 1.0) -> str:
    """Mean with its interval: over seeds if there are several, else over scenes."""
    scores = [scale * np.asarray(values(row)) for row in group]
    several = len(scores) > 1
    found = Estimate(*summary([one.tolist() for one in scores])[:3]) if several else mean_interval(scores[0])
    return f"{found.value:.1f} {found.bounds(digits)}"


def _held_out_table(found: Mapping[str, Row]) -> str:
    header = ["row", "seeds", "unseen basic", "solved %", "held-out scenes", "solved %"]
    cells = [
        [name, str(len(group)), *(_of(group, kind, key) for kind in KINDS for key in ("reward", "success"))]
        for name, group in _groups(found).items()
    ]
    return markdown_table(header, cells)


KINDS: Final = ("unseen_basic", "held_out")


def _of(group: Sequence[Row], kind: str, key: str) -> str:
    return _cell(group, lambda row: row[kind][key], scale=100.0 if key == "success" else 1.0)


def _first_table(found: Mapping[str, Row]) -> str:
    """The first try, by split."""
    cells = [
        [name, str(len(group)), *(_within(group, games, 1) for games in COLUMNS.values()), _solved(group, 1)]
        for name, group in _groups(found).items()
    ]
    header = ["first try", "seeds", *(TITLES[split] for split in COLUMNS), "solved %"]
    return markdown_table(header, cells)


def _best_table(found: Mapping[str, Row], fps: int) -> str:
    """The best of k tries, over all games, with people and the best plans known."""
    cells = [
        [name, *(_within(group, GAMES, k) for k in SHOWN), _solved(group, 5)] for name, group in _groups(found).items()
    ]
    if fps == PEOPLE_FPS:
        cells.append(["people", "-", "-", f"{np.mean(list(scores_of_people().values())):.1f}", "-", "-"])
    best = np.mean([row["reward"] for row in shipped(fps).values()])
    cells.append(["best known", *[f"{best:.1f}"] * len(SHOWN), "-"])
    return markdown_table(["best of", *map(str, SHOWN), "solved within 5 %"], cells)


def _within(group: Sequence[Row], games: Sequence[str], k: int) -> str:
    return _cell(group, lambda row: [row["best_reward"][game][k - 1] for game in games])


def _solved(group: Sequence[Row], k: int) -> str:
    return _cell(group, lambda row: [row["solved"][game][k - 1] for game in GAMES], scale=100.0)
