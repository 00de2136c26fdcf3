"""The report as one self-contained HTML page, which runs no script and loads nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from parity.compare import largest
from parity.divergences import DivergedPlan
from parity.engines import reference
from parity.play import GameResult
from parity.reports.charts import Values, error_chart, sparkline, trajectories
from parity.reports.summary import Summary
from parity.reports.tables import HEADINGS, LEGEND, Section, cells, headline, inline, percent, targets_line
from parity.statistics import PlayStatistics, Statistics

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
WORST_SHOWN = 8  # pictures of the plays with the largest errors, for each rate and type
OF_SOLVED = "\u2002of the solved ones"
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
COLOURS = ((1.0, "good"), (0.995, "fair"))  # least share of each colour; any lower share is "bad"


def page(tables: Sequence[Section], results: Sequence[GameResult], info: Mapping[str, Any]) -> str:
    """The whole report as HTML: the tables, the results behind them, and what `report.run_info` says of the run."""
    rates = tuple(dict.fromkeys(section.fps for section in tables))
    missed = any(section.missed for section in tables)
    parts = [
        f"<h1>Parity with pymunk {escape(reference.VERSION)}</h1>",
        '<p class="soft">The same plans in both engines, compared after every step.</p>',
        f'<div class="targets{" missed" if missed else ""}">{escape(headline(tables))}</div>',
        "<nav>" + "".join(f'<a href="#fps{fps}">{fps} steps a second</a>' for fps in rates),
        '<a href="#run">How to repeat this run</a></nav>',
    ]
    for fps in rates:
        parts += _rate(fps, tables, results)
    parts += ['<h2 id="run">How to repeat this run</h2>', _run_info(info)]
    style = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Parity with pymunk</title><style>{style}</style></head><body><main>\n"
        + "\n".join(parts)
        + "\n</main></body></html>\n"
    )


def _rate(fps: int, tables: Sequence[Section], results: Sequence[GameResult]) -> list[str]:
    """Everything about one frame rate."""
    tables = [section for section in tables if section.fps == fps]
    own = [result for result in results if result.fps == fps]
    parts = [f'<h2 id="fps{fps}">{fps} steps a second</h2>', _cards(tables)]
    for section in tables:
        parts += [f"<h3>{escape(section.title)}</h3>", f"<p>{escape(targets_line(section))}.</p>"]
        parts.append(_table(section, [result for result in own if result.dtype == section.dtype]))
    parts.append(f'<p class="note">{escape(LEGEND)}; error over time: the worst plan, from 1e-14 to 1e4 px.</p>')
    parts += _error_charts(own)
    for section in tables:
        parts += _worst([result for result in own if result.dtype == section.dtype], section.title)
    if any(section.dtype == "float64" for section in tables):
        parts += _diverged([plan for result in own for plan in result.diverged])
    parts += _physics([result.statistics for result in own if result.statistics])
    return parts


def _cards(tables: Sequence[Section]) -> str:
    """The main figures: a card for each type and for each comparison of the reference with itself."""
    cards = []
    for section in tables:
        row = section.overall
        facts = [
            ("plays, solved", f"{row.plans}, {row.solved}"),
            ("bit for bit", f"{percent(row.identical)} %"),
            ("within 1e-6 px", f"{percent(row.within(1e-6))} %"),
            (OF_SOLVED, f"{percent(row.share_solved)} %"),
        ]
        cards.append(_card(f"Ours, {section.dtype}", [*facts, *_outcome(row)]))
    for row in tables[0].sensitivity:
        facts = [(f"within {limit} px", f"{percent(row.within(float(limit)))} %") for limit in ("1e-9", "1e-6")]
        cards.append(_card(row.name, [*facts, *_outcome(row)]))
    return f'<div class="cards">{"".join(cards)}</div>'


def _outcome(row: Summary) -> list[tuple[str, str]]:
    return [
        ("within 1 px", f"{percent(row.within(1.0))} %"),
        ("same step", f"{percent(row.same_step)} %"),
        (OF_SOLVED, f"{percent(row.same_step_solved)} %"),
    ]


def _card(title: str, facts: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts)
    return f'<div class="card"><b>{escape(title)}</b><dl>{rows}</dl></div>'


def _table(section: Section, results: Sequence[GameResult]) -> str:
    """The table of one rate and type; each row ends with the worst error over time."""
    exact = section.dtype == "float64"
    rows = []
    for row, result in zip(section.games, results, strict=True):
        drawn = sparkline([(worst_over_plans(result), section.dtype)], logarithmic=True)
        rows.append(f"<tr>{_cells(cells(row), exact)}<td>{drawn}</td></tr>")
    rows.append(f'<tr class="all">{_cells(cells(section.overall), exact)}<td></td></tr>')
    rows += [f'<tr class="self">{_cells(cells(row), False)}<td></td></tr>' for row in section.sensitivity]
    return _html_table((*HEADINGS, "error over time"), rows)


def _html_table(headings: Sequence[str], rows: Sequence[str]) -> str:
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'


def _cells(texts: Sequence[str], exact: bool) -> str:
    """Cells of a row; `exact` colours the shares that should be 100 %."""
    out = []
    for heading, text in zip(HEADINGS, texts, strict=True):
        kind = ""
        if exact and heading in ("1e-6", "flag", "step", "flag*", "step*") and text != "-":
            share = float(text) / 100
            kind = next((name for least, name in COLOURS if share >= least), "bad")
        out.append(f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>")
    return "".join(out)


def median_over_plans(error_over_time: Values) -> Values:
    """Median of (B, bins) over the plans that have something in play, (bins,), NaN where none has."""
    filled = np.where(np.isnan(error_over_time), np.inf, error_over_time)
    count = (~np.isnan(error_over_time)).sum(axis=0)
    middle = np.take_along_axis(np.sort(filled, axis=0), np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    return np.where(count > 0, middle, np.nan)


def worst_over_plans(result: GameResult) -> Values:
    """Largest error of any plan in each interval, (bins,) px, NaN where nothing is in play."""
    return largest(result.comparison.error_over_time, 0)


def _error_charts(results: Sequence[GameResult]) -> list[str]:
    """Error over time, one chart a game."""
    charts = []
    for game in dict.fromkeys(result.game for result in results):
        own = [result for result in results if result.game == game]
        compared = sorted(own[0].sensitivity.items(), reverse=True)
        bands = [
            (median_over_plans(c.error_over_time), largest(c.error_over_time, 0), f"s{len(compared) - place}")
            for place, (_, c) in enumerate(compared)
        ]
        lines = [(median_over_plans(result.comparison.error_over_time), f"{result.dtype} typical") for result in own]
        lines += [(worst_over_plans(result), result.dtype) for result in own]
        seconds = (own[0].comparison.error_over_time.shape[1] - 1) / 10
        charts.append(f"<figure>{error_chart(game, max(seconds, 0.1), bands, lines)}</figure>")
    key = (
        '<p class="note">Error in px over time, on a logarithmic scale whose lower edge is exact zero:'
        '<span class="key float64"></span>worst play in float64<span class="key float32"></span>in float32'
        '<span class="key typical"></span>median<span class="key s1"></span>pymunk against itself under a relative '
        "change of gravity of 1e-12 (darkest), 1e-9 and 1e-6, from the median to the worst play. An error below such a "
        "band is smaller than the effect of that change.</p>"
    )
    return ["<h3>Error over time</h3>", key, f'<div class="charts">{"".join(charts)}</div>']


def _worst(results: Sequence[GameResult], title: str) -> list[str]:
    """Pictures of the plays with the largest errors."""
    shown = [result for result in results if result.worst]
    shown.sort(key=lambda result: -float(result.comparison.error.max()))
    figures = []
    for result in shown[:WORST_SHOWN]:
        assert result.worst is not None  # noqa: S101  filtered above
        c, plan = result.comparison, result.worst.plan
        caption = (
            f"<b>{escape(result.game)}</b>, plan {plan}: {c.error[plan]:.1e} px; "
            f"{_ended(c.success[plan], c.steps[plan])}, "
            f"pymunk {_ended(c.reference_success[plan], c.reference_steps[plan])}"
        )
        drawn = trajectories(result.scene, result.worst.reference, result.worst.ours)
        figures.append(f"<figure>{drawn}<figcaption>{caption}</figcaption></figure>")
    if not figures:
        return [f"<h3>Worst plays, {escape(title)}</h3>", "<p>No pose in play differs by a single bit.</p>"]
    key = (
        '<p class="note"><span class="key mine"></span>ours<span class="key theirs"></span>pymunk'
        '<span class="key black"></span>static<span class="key grey"></span>eliminable'
        '<span class="key moves"></span>moving bar<span class="key red"></span>ball (at the start)</p>'
    )
    return [
        f"<details open><summary>Worst plays, {escape(title)}</summary>",
        key,
        f'<div class="charts">{"".join(figures)}</div></details>',
    ]


def _ended(solved: bool, steps: int) -> str:
    return f"solved after {steps} steps" if solved else f"not solved ({steps} steps)"


def _diverged(plans: Sequence[DivergedPlan]) -> list[str]:
    """The plans that diverge in float64, with their first differences."""
    title = "<h3>Plans that diverge in float64</h3>"
    chosen = [plan for plan in plans if plan.dtype == "float64"]
    if not chosen:
        return [title, "<p>None.</p>"]
    rows = [
        f"<tr><td>{escape(plan.game)}</td><td>{plan.plan}</td><td>{plan.error:.1e}</td>"
        f"<td>{plan.ours[1]} / {plan.reference[1]}</td>"
        f'<td class="text">{escape(str(plan.first_bit or "-"))}</td>'
        f'<td class="text">{escape(str(plan.first_stage or "-"))}</td></tr>'
        for plan in chosen
    ]
    names = "game", "plan", "px", "steps, ours / pymunk", "first bit that differs", "first stage beyond tolerance"
    return [title, _html_table(names, rows)]


def _physics(pairs: Sequence[PlayStatistics]) -> list[str]:
    """Energy, momentum and contacts of one play of each game, side by side."""
    if not pairs:
        return []
    rows = []
    for pair in pairs:
        energies = [(side.kinetic + side.potential) for side in (pair.theirs, pair.ours)]
        drawn = sparkline(list(zip(energies, ("theirs", "mine"), strict=True)), logarithmic=False)
        both = [[f"{float(value(side)):.10g}" for side in (pair.ours, pair.theirs)] for _, value in PHYSICS]
        numbers = "".join(f'<td class="two">{ours}<span>{theirs}</span></td>' for ours, theirs in both)
        rows.append(f"<tr><td>{escape(pair.game)}</td><td>{drawn}</td>{numbers}</tr>")
    note = (
        '<p class="note">One play of each game in float64, ours above, pymunk below. Every mass is 1: energies are in '
        "px²/s² (0 at y = 600), momenta and impulses in px/s, overlap in px. Contacts and impulses are sums over the "
        f"first {max(len(pair.ours.points) / pair.fps for pair in pairs):g} s at most.</p>"
    )
    table = _html_table(("game", "energy", *(name for name, _ in PHYSICS)), rows)
    return ["<details><summary>Energy, momentum and contacts side by side</summary>", note, table, "</details>"]


def _run_info(info: Mapping[str, Any]) -> str:
    rows = "".join(
        f'<tr><td>{escape(name)}</td><td class="text"><code>{escape(inline(value))}</code></td></tr>'
        for name, value in info.items()
    )
    return f'<div class="scroll"><table><tbody>{rows}</tbody></table></div>'
