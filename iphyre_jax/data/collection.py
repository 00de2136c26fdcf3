"""`collect`: data sets of random plans, as the official loop makes them, and of other plans."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import as_floats, show
from iphyre_jax.data.dataset import Dataset, scene_entry
from iphyre_jax.data.draws import Plan, neighbours, random_plans
from iphyre_jax.data.journal import Journal, Report, journal_in
from iphyre_jax.data.labels import FIRST_RESET, FRESH, Ints, PlayProtocol, play_poses
from iphyre_jax.data.recipe import MAX_DRAWS, PlanPolicy, Recipe, check_recipe
from iphyre_jax.data.search import Search, kept_rows, run_searches
from iphyre_jax.plans import Rule
from iphyre_jax.provenance import CORE, provenance
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.library import SceneLike, load_scenes

_FLOAT32: Final = np.finfo(np.float32)


def collect(
    games: Sequence[SceneLike],
    *,
    successes: int = 50,
    failures: int = 50,
    distribution: str = "official",
    form: str = "fresh",
    fps: int = 60,
    rule: Rule = "simulate",
    resets: int = FRESH,
    seed: int = 0,
    sequences: bool = False,
    pose_dtype: str = "float32",
    max_draws: int = MAX_DRAWS,
    policy: PlanPolicy | None = None,
    journal: str | os.PathLike[str] | None = None,
    report: Report | None = None,
    save: Callable[[Dataset], object] | None = None,
) -> Dataset:
    """Draw plans of each game until enough solve it and enough do not, and play them on all cores.

    Plays are kept in the order of their draws, and the loop stops where the official one does: with the last play that
    is missing. Labels are decided in float64. The result does not depend on the number of cores, nor on a kill.

    Args:
        games: names, scene files or Scenes.
        successes: plays of each game that solve it, 0 to 100,000.
        failures: plays that do not.
        distribution: "official": the plans of the official function, times below 7 s. "uniform15": the same with times
            below 15 s. "policy": plans of `policy`. "mixed": a half as "official", then neighbours of the successes
            found there, one removal moved by 0.1 to 0.5 s, and random plans again where these do not suffice. "policy"
            and "mixed" keep no play twice.
        form: "fresh": each play in a fresh space. "exact": in the successive resets of one space, as the official loop
            plays; the labels are then those of `iphyre_jax.compat.generate_actions`. One play in 250 ends otherwise.
        fps: physics steps a second, a whole number up to 2,183; with sequences a multiple of 10.
        rule: how seconds become steps, see `plan_to_steps`: "simulate", as the official data; "in_advance", as for
            agents that plan ahead.
        resets: number of the reset of a reused space in which each play of the form "fresh" is made; 1 is a fresh
            space, 2 that of the official learning environment.
        seed: of the draws, 0 to 2**32 - 1.
        sequences: whether to keep the poses of what moves, ten a second.
        pose_dtype: "float32", or "float64" for tables that equal the official ones bit for bit.
        max_draws: of one game, 1 to 1,000,000; it has fewer plays if they do not suffice, and the manifest says so.
        policy: for "policy": of a scene and the seed, plans without end, each with a time in s for every slot of the
            scene's limits (6); 0 or NaN for a block that stays and for a slot that the scene has no block for.
        journal: a folder for what is done so far: after a kill the same call goes on there. It is removed at the end.
        report: called with a line of progress after each round.
        save: called with the data set before the journal goes, so that a kill between the two loses nothing.

    Raises:
        ValueError: one line naming the argument and what was expected.
        OSError: a scene file cannot be read, or the journal not written.
    """
    scenes = load_scenes(games)
    unique = distribution in ("policy", "mixed")
    recipe = Recipe(
        distribution, form, PlayProtocol(fps, rule, resets), seed, max_draws, policy, sequences, pose_dtype, unique
    )
    recipe = check_recipe(recipe, scenes, successes, failures)
    with journal_in(journal, report) as opened:
        dataset = gather(scenes, [(successes, failures)] * len(scenes), recipe, opened)
        if save is not None:
            save(dataset)
        return dataset


def gather(
    scenes: Sequence[Scene],
    wanted: Sequence[tuple[int, int]],
    recipe: Recipe,
    journal: Journal,
    *,
    starts: Sequence[int] | None = None,
    known: Sequence[set[bytes]] | None = None,
) -> Dataset:
    """Make a data set by a checked recipe.

    Args:
        scenes: of the set.
        wanted: plays of each scene that solve it, and that do not.
        recipe: how.
        journal: keeps what is done.
        starts: draws of each scene to leave out at the start.
        known: for a unique set, plays of each scene to leave out, as `play_keys` gives them.
    """
    begin = starts or [0] * len(scenes)
    left_out: list[set[bytes] | None] = [None] * len(scenes)
    if recipe.unique:
        left_out = [set(plays) for plays in known or [set()] * len(scenes)]
    is_mixed = recipe.distribution == "mixed"
    share = [(-(-s // 2), -(-f // 2)) if is_mixed else (s, f) for s, f in wanted]
    searches = [
        Search(_plans(scene, recipe, first), count, recipe.max_draws, first, plays)
        for scene, count, first, plays in zip(scenes, share, begin, left_out, strict=True)
    ]
    run_searches(scenes, searches, recipe.protocol, recipe.form == "exact", journal)
    found = [[search] for search in searches]
    if is_mixed:
        for next_search in (_neighbour_search, _filling_search):
            more = [next_search(scenes[k], found[k], wanted[k], recipe) for k in range(len(scenes))]
            run_searches(scenes, more, recipe.protocol, False, journal)
            found = [[*done, search] for done, search in zip(found, more, strict=True)]
    return dataset_of(scenes, found, recipe, journal)


def _plans(scene: Scene, recipe: Recipe, start: int) -> Iterator[Plan]:
    """Return the plans of a recipe for a scene, without the first ones."""
    if recipe.policy is not None:
        plans = recipe.policy(scene, recipe.seed)
        if not isinstance(plans, Iterator):
            raise ValueError(f"policy: expected an iterator of plans, got {show(plans)}")
        plans = _with_slots(plans, scene)
    else:
        drawn = "official" if recipe.distribution == "mixed" else recipe.distribution
        plans = random_plans(scene, drawn, recipe.seed)
    for _ in range(start):
        next(plans, None)
    return plans


def _with_slots(plans: Iterator[Plan], scene: Scene) -> Iterator[Plan]:
    """Yield plans; ValueError, one line, at the first that has not a time for each slot, or one for no block."""
    slots, blocks = scene.limits.blocks, len(scene.eliminable_blocks)
    for plan in plans:
        times = as_floats("policy", plan, f"plans of {slots} times")
        if times.shape != (slots,):
            raise ValueError(f"policy: expected plans of {slots} times, got one of shape {times.shape}")
        # A data set keeps float32: none may become infinite there, or 0, which removes nothing.
        played = times[~np.isnan(times)]
        held = (played == 0) | ((played >= _FLOAT32.tiny) & (played <= _FLOAT32.max))
        if not held.all():
            found = show(float(played[~held][0]))
            raise ValueError(f"policy: expected times from 0 on that float32 can hold, or NaN, got {found}")
        if np.nan_to_num(times[blocks:]).any():
            expected = f"0 or NaN after the times of the {blocks} eliminable blocks of {scene.name}"
            raise ValueError(f"policy: expected {expected}, got {show(list(plan))}")
        yield plan


def _neighbour_search(scene: Scene, done: Sequence[Search], wanted: tuple[int, int], recipe: Recipe) -> Search:
    """Return the second half of a mixed set: neighbours of the successes of the first."""
    (first,) = done
    bases = [first.times[row] for row in first.rows(True)]
    return _next_search(neighbours(bases, recipe.seed), done, wanted, recipe)


def _filling_search(scene: Scene, done: Sequence[Search], wanted: tuple[int, int], recipe: Recipe) -> Search:
    """Return what a mixed set still lacks, where there are too few neighbours of a kind: more random plans."""
    return _next_search(_plans(scene, recipe, done[0].draws()), done, wanted, recipe)


def _next_search(plans: Iterator[Plan], done: Sequence[Search], wanted: tuple[int, int], recipe: Recipe) -> Search:
    kept = [sum(len(search.rows(solved)) for search in done) for solved in (True, False)]
    rest = (wanted[0] - kept[0], wanted[1] - kept[1])
    number = done[-1].first + done[-1].draws()
    known = None if done[-1].known is None else done[-1].known - done[-1].surplus()
    return Search(plans, rest, recipe.max_draws, number, known)


def dataset_of(scenes: Sequence[Scene], found: Sequence[Sequence[Search]], recipe: Recipe, journal: Journal) -> Dataset:
    """Join the kept plays of the searches of each scene."""
    kept = [[kept_rows(search) for search in of_scene] for of_scene in found]
    counts = [sum(len(rows["draw"]) for rows in of_scene) for of_scene in kept]
    parts = [rows for of_scene in kept for rows in of_scene]
    none = np.zeros((0, scenes[0].limits.blocks))
    times = np.concatenate([none, *(rows["times"] for rows in parts if len(rows["draw"]))])
    columns = {name: np.concatenate([rows[name] for rows in parts]) for name in parts[0] if name != "times"}
    game = np.repeat(np.arange(len(scenes), dtype=np.int32), counts)
    entries = [_entry(scene, of_scene) for scene, of_scene in zip(scenes, found, strict=True)]
    return build(scenes, game, times, columns, recipe, journal, {"scenes": entries})


def build(
    scenes: Sequence[Scene],
    game: Ints,
    times: npt.NDArray[np.floating[Any]],
    columns: Mapping[str, npt.NDArray[Any]],
    recipe: Recipe,
    journal: Journal,
    manifest: Mapping[str, Any],
) -> Dataset:
    """Return a data set of labelled plans, with poses if the recipe has them.

    Args:
        scenes: of the set.
        game: (N,) index of each play's scene.
        times: (N, S) s, as drawn: 0 or NaN for a block that stays.
        columns: success, end_step, removals and draw, (N,).
        recipe: how they were made.
        journal: keeps the poses.
        manifest: fields to add: `scenes`, and others.
    """
    steps = recipe.protocol.steps(times)
    poses = None
    if recipe.sequences:
        journal.report(f"playing {len(game)} sequences")
        resets = None if recipe.form == "fresh" else columns["draw"] + FIRST_RESET
        poses = play_poses(scenes, game, steps, recipe.protocol, resets, journal).astype(recipe.pose_dtype)
    return Dataset(
        scenes=tuple(scenes),
        game=game.astype(np.int32),
        times=np.where(times == 0, np.nan, times).astype(np.float32),
        steps=steps.astype(np.int16),
        success=columns["success"],
        end_step=columns["end_step"].astype(np.int16),
        removals=columns["removals"].astype(np.int8),
        draw=columns["draw"].astype(np.int32),
        poses=poses,
        manifest={**recipe.manifest(), **manifest, "provenance": provenance(CORE)},
    )


def _entry(scene: Scene, searches: Sequence[Search]) -> dict[str, Any]:
    """Return what a manifest says of a scene; `iterations` is where the official loop stops, null if it goes on."""
    complete = not any(searches[-1].missing())
    parts = [(search, search.labels.take(np.arange(search.draws()))) for search in searches]
    return {
        **scene_entry(scene),
        "iterations": sum(search.draws() for search in searches) if complete else None,
        "first_draw": searches[0].first,
        "draws": sum(search.draws() for search in searches),
        "solved": sum(int(labels.success.sum()) for _, labels in parts),
        "faults": sum(int((labels.fault != 0).sum()) for _, labels in parts),
        "successes": sum(len(search.rows(True)) for search in searches),
        "failures": sum(len(search.rows(False)) for search in searches),
        "wait_successes": searches[0].waits()[0],
        "wait_failures": searches[0].waits()[1],
    }
