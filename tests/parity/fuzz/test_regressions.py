"""Cases that once differed from the reference, made small by `parity/shrink.py`; the shrinking; random scenes."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import Scene, load_scene
from iphyre_jax.scenes.compile import topology_of
from parity.compare import PlanComparison, compare_plans
from parity.fuzz.random_scenes import TEMPLATES, random_scene
from parity.fuzz.regressions import Case, read_case, write_case
from parity.fuzz.shrink import shrink
from parity.play import DURATION, Task, play_ours, play_reference

pytestmark = pytest.mark.usefixtures("quick_programs")  # `make parity-random` plays random scenes as users do

CASES = tuple(read_case(path) for path in sorted((Path(__file__).parent / "regressions").glob("*.json")))


@pytest.fixture(scope="module")
def compared() -> dict[str, PlanComparison]:
    """All cases, those of one frame rate and reset together, so that each layout is compiled once."""
    groups: dict[tuple[int, int], list[Case]] = defaultdict(list)
    for case in CASES:
        groups[case.fps, case.resets].append(case)
    found = {}
    for (fps, resets), cases in groups.items():
        scenes, plans = [case.scene for case in cases], [case.plan[None] for case in cases]
        task = Task(tuple(scenes), 1, (fps,), ("float64",), resets, 0)
        for case, ours in zip(cases, play_ours(scenes, plans, fps, "float64", task), strict=True):
            theirs = play_reference(case.scene, case.plan[None], fps, DURATION, resets)
            found[case.scene.name] = compare_plans(theirs, ours, case.scene.dynamic, fps)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=[case.scene.name for case in CASES])
def test_a_case_is_equal_bit_for_bit(case: Case, compared: dict[str, PlanComparison]) -> None:
    assert compared[case.scene.name].identical.all(), case.why


def test_a_case_is_read_as_it_was_written(tmp_path: Path) -> None:
    case = Case(load_scene("hole"), (5, -1, 7, -1), 10, 2, "nothing")
    assert read_case(write_case(tmp_path / "cases", case)) == case


def test_shrinking_keeps_what_it_is_asked_to_keep() -> None:
    scene = random_scene(11)  # a bar and five balls
    assert (scene.dynamic.sum(), TEMPLATES[11].moving) == (6, 6)
    plan = np.arange(len(scene.eliminable_blocks))

    def has_a_moving_bar_and_two_balls(case: Scene, rows: np.ndarray) -> bool:
        assert len(rows) == len(case.eliminable_blocks)
        return bool(case.dynamic[: case.n_blocks].any()) and case.n_balls >= 2

    small, rows = shrink(scene, plan, has_a_moving_bar_and_two_balls)
    assert (small.n_blocks, small.n_balls, rows.tolist()) == (1, 2, [])
    assert not np.any(np.concatenate([small.blocks.ravel(), small.balls[:, :2].ravel()]) % 10)


def test_random_scenes_are_what_they_promise() -> None:
    scenes = [random_scene(index) for index in range(240)]
    assert scenes == [random_scene(index) for index in range(240)]
    assert scenes[:24] != [random_scene(index, seed=1) for index in range(24)]
    for index, scene in enumerate(scenes):
        template = TEMPLATES[index % len(TEMPLATES)]
        assert (scene.dynamic.sum(), scene.n_balls) == (template.moving, template.balls)
        ends = [end for pair in (*scene.joints, *scene.springs) for end in pair if scene.eliminable[end]]
        assert len(ends) == len(set(ends)), scene.name
    counts = {scene.n_objects for scene in scenes}
    assert min(counts) <= 2
    assert max(counts) == 12


def test_random_scenes_need_no_more_programs_than_templates() -> None:
    topologies = {topology_of(random_scene(index)) for index in range(240)}
    assert len(topologies) == len(TEMPLATES) <= 24


def test_templates_have_every_sort_of_link() -> None:
    sorts: set[tuple[str, str]] = set()
    for template in TEMPLATES:
        names = ["bar"] * template.bars + ["ball"] * template.balls + ["static"]  # STATIC, -1, is the last
        for sort, links in (("joint", template.joints), ("spring", template.springs)):
            sorts |= {(sort, " ".join(sorted((names[a], names[b])))) for a, b in links}
    ends = ("ball ball", "ball bar", "bar bar", "ball static", "bar static")
    assert sorts == {(sort, end) for sort in ("joint", "spring") for end in ends}
