"""The report as one self-contained HTML page: no script, nothing loaded from anywhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from parity.divergences import Astray
from parity.engines import reference
from parity.play import GameResult
from parity.reports.charts import Values, error_chart, sparkline, trajectories
from parity.reports.tables import HEADINGS, LEGEND, Section, cells, headline, percent, verdict_line
from parity.statistics import PlayStatistics, Statistics

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
WORST_SHOWN = 8  # pictures of the plays that went furthest astray, for each rate and type
OF_SOLVED = "\u2002of those solved"
PHYSICS: tuple[tuple[str, Callable[[Statistics], float]], ...] = (
    ("energy at the end", lambda side: side.kinetic[-1] + side.potential[-1]),
    ("most kinetic", lambda side: side.kinetic.max()),
    ("momentum x", lambda side: side.momentum_x[-1]),
    ("momentum y", lambda side: side.momentum_y[-1]),
    ("contact points", lambda side: side.points.sum()),
    ("ball-ball", lambda side: side.ball_ball.sum()),
    ("ball-bar", lambda side: side.ball_bar.sum()),
    ("bar-bar", lambda side: side.bar_bar.sum()),
    ("normal impulses", lambda side: side.impulse.sum()),
    ("deepest overlap", lambda side: side.overlap.max()),
)
LIMITS = ((1.0, "good"), (0.995, "fair"))  # a share's colour, by the least share; below the last it is bad


def page(made: Sequence[Section], results: Sequence[GameResult], around: Mapping[str, Any]) -> str:
    """The whole report.

    Args:
        made: the tables.
        results: what they were made of.
        around: versions, machine, commit and arguments.

    Returns:
        HTML.
    """
    rates = tuple(dict.fromkeys(section.fps for section in made))
    missed = any(section.missed for section in made)
    parts = [
        f"<h1>Parity with pymunk {escape(reference.VERSION)}</h1>",
        '<p class="soft">The same plans in both engines, compared after every step.</p>',
        f'<div class="verdict{" missed" if missed else ""}">{escape(headline(made))}</div>',
        "<nav>" + "".join(f'<a href="#fps{fps}">{fps} steps a second</a>' for fps in rates),
        '<a href="#around">Circumstances</a></nav>',
    ]
    for fps in rates:
        parts += _rate(fps, made, results)
    parts += ['<h2 id="around">Circumstances</h2>', _circumstances(around)]
    style = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Parity with pymunk</title><style>{style}</style></head><body><main>\n"
        + "\n".join(parts)
        + "\n</main></body></html>\n"
    )


def _rate(fps: int, made: Sequence[Section], results: Sequence[GameResult]) -> list[str]:
    """Everything about one frame rate, which is a physics of its own."""
    tables = [section for section in made if section.fps == fps]
    own = [result for result in results if result.fps == fps]
    parts = [f'<h2 id="fps{fps}">{fps} steps a second</h2>', _cards(tables)]
    for section in tables:
        parts += [f"<h3>{escape(section.title)}</h3>", f"<p>{escape(verdict_line(section))}.</p>"]
        parts.append(_table(section, [result for result in own if result.dtype == section.dtype]))
    parts.append(f'<p class="note">{escape(LEGEND)}. Course: the worst error against time, from 1e-14 to 1e4 px.</p>')
    parts += _courses(own)
    for section in tables:
        parts += _worst([result for result in own if result.dtype == section.dtype], section.title)
    parts += _astray([plan for result in own for plan in result.astray])
    parts += _physics([result.statistics for result in own if result.statistics])
    return parts


def _cards(tables: Sequence[Section]) -> str:
    """The figures that matter, a card for each type, and one for the reference against itself."""
    cards = []
    for section in tables:
        row = section.overall
        facts = [
            ("plays, solved", f"{row.plans}, {row.solved}"),
            ("bit for bit", f"{percent(row.identical)} %"),
            ("within 1e-6 px", f"{percent(row.within(1e-6))} %"),
            (OF_SOLVED, f"{percent(row.share_solved)} %"),
            ("within 1 px", f"{percent(row.within(1.0))} %"),
            ("same step", f"{percent(row.same_step)} %"),
            (OF_SOLVED, f"{percent(row.same_step_solved)} %"),
        ]
        cards.append(_card(f"Ours, {section.dtype}", facts))
    for row in tables[0].sensitivity:
        cards.append(
            _card(
                row.name,
                [
                    ("within 1e-9 px", f"{percent(row.within(1e-9))} %"),
                    ("within 1e-6 px", f"{percent(row.within(1e-6))} %"),
                    ("within 1 px", f"{percent(row.within(1.0))} %"),
                    ("same step", f"{percent(row.same_step)} %"),
                    (OF_SOLVED, f"{percent(row.same_step_solved)} %"),
                ],
            )
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _card(title: str, facts: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts)
    return f'<div class="card"><b>{escape(title)}</b><dl>{rows}</dl></div>'


def _table(section: Section, results: Sequence[GameResult]) -> str:
    """The table of one rate and type, with the course of the worst error in each row."""
    exact = section.dtype == "float64"
    head = "".join(f"<th>{escape(heading)}</th>" for heading in (*HEADINGS, "course"))
    rows = []
    for row, result in zip(section.games, results, strict=True):
        drawn = sparkline([(worst_course(result), section.dtype)], logarithmic=True)
        rows.append(f"<tr>{_cells(cells(row), exact)}<td>{drawn}</td></tr>")
    rows.append(f'<tr class="all">{_cells(cells(section.overall), exact)}<td></td></tr>')
    rows += [f'<tr class="self">{_cells(cells(row), False)}<td></td></tr>' for row in section.sensitivity]
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _cells(texts: Sequence[str], exact: bool) -> str:
    """Cells of a row; of the shares that float64 should have in full, those that fall short are coloured."""
    out = []
    for heading, text in zip(HEADINGS, texts, strict=True):
        kind = ""
        if exact and heading in ("1e-6", "flag", "step", "flag*", "step*") and text != "-":
            share = float(text) / 100
            kind = next((name for least, name in LIMITS if share >= least), "bad")
        out.append(f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>")
    return "".join(out)


def median_course(course: Values) -> Values:
    """Median over the plans that have something in play, NaN where none has; course: (B, bins)."""
    filled = np.where(np.isnan(course), np.inf, course)
    count = (~np.isnan(course)).sum(axis=0)
    middle = np.take_along_axis(np.sort(filled, axis=0), np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    return np.where(count > 0, middle, np.nan)


def worst_course(result: GameResult) -> Values:
    """Largest error of any plan in every tenth of a second, (bins,) px, NaN where nothing is in play."""
    return _largest(result.comparison.course)


def _largest(course: Values) -> Values:
    most = np.where(np.isnan(course), -1.0, course).max(axis=0)
    return np.where(most < 0, np.nan, most)


def _courses(results: Sequence[GameResult]) -> list[str]:
    """Error against time, a chart a game."""
    charts = []
    for game in dict.fromkeys(result.game for result in results):
        own = [result for result in results if result.game == game]
        itself = [own[0].sensitivity[part].course for part in sorted(own[0].sensitivity, reverse=True)]
        bands = [
            (median_course(course), _largest(course), f"s{len(itself) - place}") for place, course in enumerate(itself)
        ]
        lines = [(median_course(result.comparison.course), f"{result.dtype} typical") for result in own]
        lines += [(worst_course(result), result.dtype) for result in own]
        seconds = (own[0].comparison.course.shape[1] - 1) / 10
        charts.append(f"<figure>{error_chart(game, max(seconds, 0.1), bands, lines)}</figure>")
    key = (
        '<p class="note">Error in px (logarithmic; exact zero is the lower edge) against time:'
        '<span class="key float64"></span>worst play in float64<span class="key float32"></span>in float32'
        '<span class="key typical"></span>median<span class="key s1"></span>pymunk against itself under gravity '
        "changed by a part in 1e12 (darkest), 1e9 and 1e6, from the median to the worst play: what lies below such a "
        "band is less than what that change of the world does.</p>"
    )
    return ["<h3>Error against time</h3>", key, f'<div class="charts">{"".join(charts)}</div>']


def _worst(results: Sequence[GameResult], title: str) -> list[str]:
    """Pictures of the plays that went furthest astray."""
    astray = [result for result in results if result.worst]
    astray.sort(key=lambda result: -float(result.comparison.error.max()))
    figures = []
    for result in astray[:WORST_SHOWN]:
        assert result.worst is not None  # noqa: S101  chosen so
        c, plan = result.comparison, result.worst.plan
        told = (
            f"<b>{escape(result.game)}</b>, plan {plan}: {c.error[plan]:.1e} px; "
            f"{_ended(c.success[plan], c.steps[plan])}, "
            f"pymunk {_ended(c.reference_success[plan], c.reference_steps[plan])}"
        )
        drawn = trajectories(result.scene, result.worst.reference, result.worst.ours)
        figures.append(f"<figure>{drawn}<figcaption>{told}</figcaption></figure>")
    if not figures:
        return [f"<h3>Worst plays, {escape(title)}</h3>", "<p>No play differs in play by a single bit.</p>"]
    key = (
        '<p class="note"><span class="key mine"></span>ours<span class="key theirs"></span>pymunk'
        '<span class="key black"></span>static<span class="key grey"></span>can be removed'
        '<span class="key moves"></span>moving bar<span class="key red"></span>ball, where they start</p>'
    )
    return [
        f"<details open><summary>Worst plays, {escape(title)}</summary>",
        key,
        f'<div class="charts">{"".join(figures)}</div></details>',
    ]


def _ended(solved: bool, steps: int) -> str:
    return f"solved after {steps} steps" if solved else f"not solved ({steps} steps)"


def _astray(plans: Sequence[Astray]) -> list[str]:
    """The plans of float64 that end differently or stray too far, with their first difference."""
    chosen = [plan for plan in plans if plan.dtype == "float64"]
    if not chosen:
        return ["<h3>Plans that go astray in float64</h3>", "<p>None.</p>"]
    rows = [
        f"<tr><td>{escape(plan.game)}</td><td>{plan.plan}</td><td>{plan.error:.1e}</td>"
        f"<td>{plan.ours[1]} / {plan.reference[1]}</td>"
        f'<td class="text">{escape(str(plan.first_bit or "-"))}</td>'
        f'<td class="text">{escape(str(plan.first_stage or "-"))}</td></tr>'
        for plan in chosen
    ]
    head = "".join(
        f"<th>{name}</th>"
        for name in (
            "game",
            "plan",
            "px",
            "steps, ours / pymunk",
            "first bit that differs",
            "first stage beyond tolerance",
        )
    )
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    return ["<h3>Plans that go astray in float64</h3>", table]


def _physics(pairs: Sequence[PlayStatistics]) -> list[str]:
    """Energy, momentum and contacts of one play a game, side by side."""
    if not pairs:
        return []
    rows = []
    for pair in pairs:
        energies = [(side.kinetic + side.potential) for side in (pair.theirs, pair.ours)]
        drawn = sparkline(list(zip(energies, ("theirs", "mine"), strict=True)), logarithmic=False)
        both = [[f"{float(value(side)):.10g}" for side in (pair.ours, pair.theirs)] for _, value in PHYSICS]
        numbers = "".join(f'<td class="two">{ours}<span>{theirs}</span></td>' for ours, theirs in both)
        rows.append(f"<tr><td>{escape(pair.game)}</td><td>{drawn}</td>{numbers}</tr>")
    head = "".join(f"<th>{name}</th>" for name in ("game", "energy", *(name for name, _ in PHYSICS)))
    note = (
        '<p class="note">One play of each game, both engines running free in float64, ours above, pymunk below. '
        "Masses are 1: energies in px²/s² (0 at y = 600), momenta and impulses in px/s, overlap in px; contacts and "
        f"impulses are sums over the first {len(pairs[0].ours.points) / pairs[0].fps:g} s at most.</p>"
    )
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    return ["<details><summary>Energy, momentum and contacts side by side</summary>", note, table, "</details>"]


def _circumstances(around: Mapping[str, Any]) -> str:
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="text"><code>{escape(_told(value))}</code></td></tr>'
        for name, value in around.items()
    )
    return f'<div class="scroll"><table><tbody>{rows}</tbody></table></div>'


def _told(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_told(inner)}" for name, inner in value.items())
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
