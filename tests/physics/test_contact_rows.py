"""One contact point against formulae in NumPy: masses, wanted speeds, relative velocity, what an impulse does."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.physics import contact_rows, solver
from iphyre_jax.physics.constants import BAR_MOMENT, BIAS_BASE, SLOP
from iphyre_jax.physics.contacts import BODY_BITS, STATIC_BODY, Points
from iphyre_jax.physics.types import Cache, Motion
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.physics.geometry import dot, number, vec
from tests.physics.worlds import DTYPES, make_scene

both = pytest.mark.parametrize("dtype", DTYPES)

DT = 1 / 60
NAMES = "normal_mass", "tangent_mass", "bias", "bounce"
PAIRS = np.array([(0, 1), (0, 2), (1, 3), (2, 3), (3, 2), (2, 0), (1, STATIC_BODY), (3, STATIC_BODY)] * 4)
RADII = 20.0, 30.0  # of the balls, bodies 2 and 3; bodies 0 and 1 are bars
INERTIA = np.array([BAR_MOMENT, BAR_MOMENT, 200.0, 450.0])
GENERATOR = np.random.default_rng(0)
NORMAL = np.exp(1j * GENERATOR.uniform(-np.pi, np.pi, len(PAIRS)))
DISTANCE = GENERATOR.uniform(-3, 0.5, len(PAIRS))
VELOCITY = GENERATOR.normal(0, 100, 4) + 1j * GENERATOR.normal(0, 100, 4)
SPIN = GENERATOR.normal(0, 3, 4)
IMPULSE, PUSH = GENERATOR.normal(0, 50, (2, len(PAIRS))), GENERATOR.normal(0, 5, len(PAIRS))


def cross(a: Any, b: Any) -> Any:
    return (a.conj() * b).imag


def arms(side: int) -> Any:
    """Return the arms of the first or second bodies: anywhere for bars, along the normal for balls."""
    body, towards = PAIRS[:, side], NORMAL * (1 - 2 * side)
    free = np.random.default_rng(1 + side).uniform(-50, 50, (2, len(PAIRS)))
    return np.where(body < 2, free[0] + 1j * free[1], towards * np.where(body == 2, *RADII))


def per_body(values: Any, side: int) -> Any:
    """Return what belongs to the first or second body of each contact, 0 for a static one."""
    return np.append(values, np.zeros(STATIC_BODY + 1 - len(values)))[PAIRS[:, side]]


def inverse_masses(direction: Any) -> Any:
    """Return 1 / effective mass along a direction: 1 / m + (r x n)^2 / I of the bodies that move."""
    return sum(per_body(np.ones(4), s) + per_body(1 / INERTIA, s) * cross(arms(s), direction) ** 2 for s in (0, 1))


def approach(velocity: Any = VELOCITY, spin: Any = SPIN) -> Any:
    first, second = (per_body(velocity, side) + 1j * per_body(spin, side) * arms(side) for side in (0, 1))
    return second - first


@cache
def contacts(dtype: str) -> tuple[Any, Callable[[], contact_rows.Contact]]:
    """Return the world, and what returns its contact points, each in a lane, as the solver prepares them."""
    bars, balls = [(50, 50, 150, 60), (50, 150, 150, 160)], [(300, 50, RADII[0]), (300, 150, RADII[1])]
    _, world = compile_scene(make_scene(balls, moving=bars), dtype=dtype)
    with jax.enable_x64(dtype == "float64"):
        columns = [part for row in (NORMAL, arms(0), arms(1)) for part in (row.real, row.imag)]
        tag = (np.arange(len(PAIRS)) << 2 * BODY_BITS) | (PAIRS[:, 0] << BODY_BITS) | PAIRS[:, 1]
        points = Points(jnp.asarray(tag, jnp.int32), jnp.asarray(np.stack([*columns, DISTANCE], 1), dtype))
        empty = jnp.zeros((3, 1), dtype)
        known = Cache(jnp.full((3, 1), -1, jnp.int32), empty, empty)
        v, w = vec(VELOCITY, dtype), jnp.asarray(SPIN, dtype)
        bodies = solver.unstack(Motion(v, w, v, w), 4)
        used = jnp.int32(len(PAIRS))
        prepared = jax.jit(solver.prestep)(world, step_timing(1 / DT, dtype), points, used, bodies, known)
        form = contact_rows.form_of(world)
        return world, partial(contact_rows.unpack_contact, prepared.fixed, form, axis=1)


def motions(dtype: str) -> list[Motion]:
    """Return the bodies' motions, once for each contact; the bias velocities are a tenth of the velocities."""
    out = []
    for v, w in zip(VELOCITY, SPIN, strict=True):
        full_v, full_w = np.full(len(PAIRS), v), np.full(len(PAIRS), w)
        spins = [jnp.asarray(part, dtype) for part in (full_w, full_w / 10)]
        out.append(Motion(vec(full_v, dtype), spins[0], vec(full_v / 10, dtype), spins[1]))
    return out


def near(dtype: str) -> Any:
    return {"rtol": 1e-12, "atol": 1e-10} if dtype == "float64" else {"rtol": 2e-5, "atol": 2e-3}


@both
def test_masses_and_wanted_speeds(dtype: str) -> None:
    _, contact = contacts(dtype)
    with jax.enable_x64(dtype == "float64"):
        read = jax.jit(lambda: {name: getattr(contact(), name) for name in NAMES})
        known = {name: np.asarray(row) for name, row in read().items()}
    np.testing.assert_allclose(known["normal_mass"], 1 / inverse_masses(NORMAL), **near(dtype))
    np.testing.assert_allclose(known["tangent_mass"], 1 / inverse_masses(1j * NORMAL), **near(dtype))
    assert (known["bias"] == 0).any()  # overlaps within the slop are left alone
    wanted = (1 - BIAS_BASE**DT) * np.maximum(-DISTANCE - SLOP, 0) / DT
    np.testing.assert_allclose(known["bias"], wanted, **near(dtype))
    np.testing.assert_allclose(known["bounce"], 0.01 * dot(approach(), NORMAL), **near(dtype))


@both
def test_relative_velocity_along_normal_and_tangent(dtype: str) -> None:
    _, contact = contacts(dtype)
    for bias, factor in ((False, 1), (True, 0.1)):
        with jax.enable_x64(dtype == "float64"):
            measure = jax.jit(lambda bodies, bias=bias: contact_rows.relative_velocity(contact(), bodies, bias=bias))
            speed = measure(motions(dtype))
        np.testing.assert_allclose(number(speed), factor * approach() / NORMAL, **near(dtype))


@both
def test_an_impulse_moves_and_turns_both_bodies(dtype: str) -> None:
    """By the formulae; and moving bodies keep their momentum and their angular momentum about any point."""
    with jax.enable_x64(dtype == "float64"):
        world, contact = contacts(dtype)
        apply = jax.jit(lambda *given: contact_rows.apply_impulse(world, contact(), *given))
        after = apply(motions(dtype), vec(IMPULSE[0] + 1j * IMPULSE[1], dtype), jnp.asarray(PUSH, dtype))
    both_move = PAIRS[:, 1] != STATIC_BODY
    fields = ("velocity", "angular_velocity", 1), ("bias_velocity", "bias_angular_velocity", 0.1)
    for (linear, angular, factor), given in zip(fields, (IMPULSE[0] + 1j * IMPULSE[1], PUSH), strict=True):
        momentum, turn = np.zeros(len(PAIRS), complex), np.zeros(len(PAIRS))
        for body in range(4):
            sign = 1.0 * (PAIRS[:, 1] == body) - (PAIRS[:, 0] == body)
            arm = np.where(sign > 0, arms(1), arms(0))
            j = sign * given * NORMAL
            v, w = number(getattr(after[body], linear)), np.asarray(getattr(after[body], angular))
            np.testing.assert_allclose(v, factor * VELOCITY[body] + j, **near(dtype))
            np.testing.assert_allclose(w, factor * SPIN[body] + cross(arm, j) / INERTIA[body], **near(dtype))
            change = v - factor * VELOCITY[body]
            momentum += change
            turn += cross(-arm, change) * abs(sign) + INERTIA[body] * (w - factor * SPIN[body])
        np.testing.assert_allclose(momentum[both_move], 0, atol=1e-10 if dtype == "float64" else 1e-4)
        np.testing.assert_allclose(turn[both_move], 0, atol=1e-8 if dtype == "float64" else 0.2)


@both
def test_the_masses_are_those_of_the_impulses(dtype: str) -> None:
    """The impulse mass * (wanted - speed) along either axis gives exactly the wanted speed there."""
    with jax.enable_x64(dtype == "float64"):
        world, contact = contacts(dtype)

        @jax.jit
        def correct(bodies: list[Motion]) -> list[jax.Array]:
            row = contact()
            speed = contact_rows.relative_velocity(row, bodies)
            along = Vec(row.normal_mass * (7 - speed.x), jnp.zeros_like(speed.x))
            across = Vec(jnp.zeros_like(speed.x), row.tangent_mass * (-3 - speed.y))
            after = [contact_rows.apply_impulse(world, row, bodies, impulse) for impulse in (along, across)]
            measured = [contact_rows.relative_velocity(row, bodies) for bodies in after]
            return [measured[0].x, measured[1].y]

        speeds = correct(motions(dtype))
    for speed, wanted in zip(speeds, (7, -3), strict=True):
        np.testing.assert_allclose(speed, wanted, atol=1e-10 if dtype == "float64" else 1e-3)


@both
def test_a_ball_alone_on_a_bar_is_the_first_body_and_needs_no_sign(dtype: str) -> None:
    _, world = compile_scene(make_scene([(300, 50, RADII[0])], [(0, 300, 600, 300)]), dtype=dtype)
    along = RADII[0] * (-NORMAL if dtype == "float64" else np.full(len(PAIRS), -1))  # in float32 in the contact's frame
    given = IMPULSE[0] + 1j * IMPULSE[1]

    @jax.jit
    def push(body: Motion) -> tuple[Vec, Motion]:
        arm, one = vec(along, dtype), jnp.ones(len(PAIRS), dtype)
        ball = contact_rows.Arm(arm.x, arm.y if dtype == "float64" else None)
        contact = contact_rows.Contact(vec(NORMAL, dtype), one, one, one, one, (), (ball,))
        speed = contact_rows.relative_velocity(contact, [body])
        return speed, contact_rows.apply_impulse(world, contact, [body], vec(given, dtype))[0]

    with jax.enable_x64(dtype == "float64"):
        speed, after = push(motions(dtype)[2])
    arm, j = RADII[0] * NORMAL, given * NORMAL
    np.testing.assert_allclose(number(speed), -(VELOCITY[2] + 1j * SPIN[2] * arm) / NORMAL, **near(dtype))
    np.testing.assert_allclose(number(after.velocity), VELOCITY[2] - j, **near(dtype))
    np.testing.assert_allclose(after.angular_velocity, SPIN[2] - cross(arm, j) / INERTIA[2], **near(dtype))


@pytest.mark.parametrize("bars", [0, 2])
@both
def test_packed_contacts_come_back(bars: int, dtype: str) -> None:
    """Every field has a row of its own; a lone body needs no sign, a ball in float32 no second component."""
    for moving in (bars + 1, bars + 2):
        form = contact_rows.form(bars, moving, exact=dtype == "float64")
        rows = np.arange(contact_rows.fields(form), dtype=dtype)

        def come_back(rows: jax.Array, form: contact_rows.Form = form, moving: int = moving) -> jax.Array:
            contact = contact_rows.unpack_contact(rows, form)
            assert len(contact.sign) == (moving if moving > 1 else 0)
            assert [arm.y is not None for arm in contact.arm] == [dtype == "float64" or k < bars for k in range(moving)]
            return contact.pack()

        with jax.enable_x64(dtype == "float64"):
            np.testing.assert_array_equal(jax.jit(come_back)(rows), rows)
