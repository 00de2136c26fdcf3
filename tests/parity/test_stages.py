"""Stage by stage: the engines agree, and where they would not, the report names the stage."""

from dataclasses import fields, replace

import jax
import numpy as np
import pytest

from iphyre_jax import load_scene
from parity.engines.instrumented import JaxWorld
from parity.engines.reference import schedule
from parity.engines.trace import TracedWorld
from parity.engines.views import StepView, reference_view
from parity.plans import random_plans
from parity.stages import compare_step, first_divergence

# Each brings something the others lack: crossing cores and roles (seesaw), collinear bars (noisy_fill), two balls
# (multi_ball_hole), clashing contact ids (multi_ball_lever), a joint between moving bodies (impulse_pendulum), a spring
# (impulse_spring).
STAGED = (
    pytest.param("support_hole", 60, 1, marks=pytest.mark.further),
    pytest.param("seesaw", 10, 1, marks=pytest.mark.further),
    pytest.param("noisy_fill", 10, 1, marks=pytest.mark.further),
    pytest.param("multi_ball_hole", 60, 1, marks=pytest.mark.further),
    ("multi_ball_lever", 10, 1),
    ("multi_ball_lever", 10, 2),
    pytest.param("impulse_pendulum", 60, 3, marks=pytest.mark.further),
    pytest.param("impulse_spring", 60, 1, marks=pytest.mark.further),
)


@pytest.mark.slow
@pytest.mark.parametrize(("game", "fps", "resets"), STAGED)
def test_every_stage_agrees_with_the_reference(game: str, fps: int, resets: int) -> None:
    scene = load_scene(game)
    for row in random_plans(scene, 3, fps, seed=4):
        found = first_divergence(scene, row, fps=fps, steps=300 if fps == 60 else 150, resets=resets)
        assert found is None or found.knife_edge, str(found)


@pytest.fixture(scope="module")
def view() -> StepView:
    """A step of the reference with two-point contacts and several pairs, at rest on its bars."""
    scene = load_scene("multi_ball_spring_flick")
    world = TracedWorld(scene)
    for _ in range(100):
        records = world.step(1 / 60)
    with jax.enable_x64(True):
        layout = JaxWorld(scene, 1, 60).layout
    made = reference_view(layout, world.state(), records, world.constraint_impulses())
    assert len(set(made.pairs)) >= 2
    return made


def test_a_view_equals_itself(view: StepView) -> None:
    assert compare_step(0, view, view, 0) is None


@pytest.mark.parametrize(
    ("field", "stage"),
    [
        ("position", "positions"),
        ("angle", "angles"),
        ("normal", "normals"),
        ("arm_a", "contact points on a"),
        ("arm_b", "contact points on b"),
        ("masses", "contact masses"),
        ("speeds", "bounce and bias speeds"),
        ("impulses", "contact impulses"),
        ("constraint_impulses", "joints and springs"),
        ("velocity", "velocities"),
        ("angular_velocity", "angular velocities"),
    ],
)
def test_a_planted_difference_is_found_in_its_stage(view: StepView, field: str, stage: str) -> None:
    assert field in {f.name for f in fields(StepView)}
    values = np.array(getattr(view, field), dtype=float)
    values.flat[-1] += 1e-3
    found = compare_step(7, replace(view, **{field: values}), view, 0)
    assert found is not None
    assert (found.step, found.stage, found.knife_edge) == (7, stage, False)


def test_a_missing_contact_is_found(view: StepView) -> None:
    fewer = replace(view, pairs=view.pairs[:-1], separation=view.separation[:-1])
    found = compare_step(0, fewer, view, 0)
    assert found is not None
    assert found.stage == "contacts"


def test_a_contact_at_distance_zero_is_called_a_knife_edge(view: StepView) -> None:
    touching = replace(view, separation=np.append(view.separation[:-1], 1e-15))
    found = compare_step(0, replace(view, pairs=view.pairs[:-1], separation=view.separation[:-1]), touching, 0)
    assert found is not None
    assert found.knife_edge


def test_another_order_and_other_roles_are_found(view: StepView) -> None:
    turned = compare_step(0, replace(view, pairs=view.pairs[::-1], separation=view.separation[::-1]), view, 0)
    assert turned is not None
    assert turned.stage == "visit order"
    (a, b), *others = view.pairs
    swapped = compare_step(0, replace(view, pairs=((b, a), *others)), view, 0)
    assert swapped is not None
    assert swapped.stage == "roles"


def test_elimination_is_scheduled_by_column() -> None:
    scene = load_scene("hole")
    blocks = scene.eliminable_blocks
    plan = np.full(len(blocks), -1)
    plan[[0, 1]] = 4
    assert schedule(scene, plan) == {4: [blocks[0], blocks[1]]}
