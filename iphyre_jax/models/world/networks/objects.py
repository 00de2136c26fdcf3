"""`objects`: bodies fall freely, and each near object or tie answers with an impulse that a network has learned.

A step of 0.1 s is made in a few parts. In each part a small network sees every pair of a body and a near object in the
frame of their contact (gap, normal and tangential speed, arms, gravity, how far the ends are) and gives a change of
their relative speed and place; masses and arms turn it into changes of the body's speed, spin, place and angle. Seen in
this frame, a slope here is a slope anywhere. A body that touches nothing falls exactly.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks.geometry import length
from iphyre_jax.models.world.networks.mlp import apply, mlp
from iphyre_jax.models.world.networks.pairs import ANSWERS, FEATURES, near_edges, pair_of, pushed, speed_features
from iphyre_jax.models.world.networks.ties import TIE_ANSWERS, TIE_FEATURES, tie_push
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import SceneTables, State
from iphyre_jax.physics.constants import GRAVITY
from iphyre_jax.rules import DECISIONS_PER_SECOND

STEPS: Final = 6  # physics steps in 0.1 s
TICK: Final = 1 / (STEPS * DECISIONS_PER_SECOND)  # s
BOUNDS: Final = ((0.002, 60.0), (0.02, 400.0), (0.0001, 3.0), (0.001, 30.0))  # of sigma: px, px/s, rad, rad/s

Params = dict[str, Any]


class Sigma(NamedTuple):
    """How large 68 % of the errors of what is predicted are at most, each (B, M) and within BOUNDS."""

    centre: jax.Array  # px, in x and in y
    velocity: jax.Array  # px/s
    angle: jax.Array  # rad
    spin: jax.Array  # rad/s


def init(config: WorldConfig, key: jax.Array) -> Params:
    """Parameters before training."""
    keys = jax.random.split(key, 3)
    return {
        "contact": mlp(keys[0], FEATURES + config.latent, config.width, ANSWERS + config.latent),
        "tie": mlp(keys[1], TIE_FEATURES, config.width, TIE_ANSWERS),
        "sigma": mlp(keys[2], config.latent + 4, config.width // 2, 4),
        "log_moment": jnp.zeros(2),  # of bars in 100 px^2, of balls in half their squared radius
    }


def step(
    config: WorldConfig, params: Params, scene: SceneTables, state: State, alive: jax.Array, neighbours: int
) -> tuple[State, Sigma]:
    """What the moving bodies of B worlds do within 0.1 s.

    Args:
        config: settings.
        params: as `init` gives them.
        scene: tables of the scene of each world, (B, ...).
        state: of each world.
        alive: (B, 12) bool, objects that are there from the beginning of the 0.1 s on.
        neighbours: objects that a body may touch.

    Returns:
        The mean of the next state, and the size of its errors.
    """
    edges = near_edges(scene, state, alive, neighbours)
    ticks = STEPS // config.parts
    part = ticks * TICK
    latent = jnp.zeros((*edges.other.shape, config.latent))
    activity = jnp.zeros((*state.angle.shape, config.latent))
    down = jnp.array([[[0.0, 1.0]]])

    def advance(carry: tuple[State, jax.Array, jax.Array], _: None) -> tuple[tuple[State, jax.Array, jax.Array], None]:
        state, latent, activity = carry
        pair = pair_of(params, scene, state, edges)
        tie_speed, tie_place = tie_push(params, scene, state, alive)
        free = state._replace(velocity=state.velocity + GRAVITY * part * down + tie_speed)
        # As the solver does: places by the speeds of the step before, then speeds.
        place = state.centre + state.velocity * part + GRAVITY * TICK**2 * (ticks * (ticks - 1) / 2) * down
        for _pass in range(config.passes):
            seen = jnp.concatenate([pair.fixed, speed_features(pair, scene, free, edges, part), latent], axis=-1)
            answer = apply(params["contact"], seen)
            latent = jnp.tanh(answer[..., ANSWERS:]) * pair.gate[..., None]
            push = pushed(params, scene, pair, answer[..., :ANSWERS])
            free = free._replace(velocity=free.velocity + push.velocity, spin=free.spin + push.spin)
        angle = state.angle + state.spin * part + push.angle
        moved = State(place + tie_place + push.centre, angle, free.velocity, free.spin)
        return (moved, latent, activity + latent.sum(axis=2)), None

    (state, _, activity), _ = jax.lax.scan(advance, (state, latent, activity), None, length=config.parts)
    return state, _sigma(params, state, activity)


def _sigma(params: Params, state: State, activity: jax.Array) -> Sigma:
    speed = jnp.concatenate(
        [state.velocity / 200, state.spin[..., None] / 5, length(state.velocity)[..., None] / 200], -1
    )
    logits = apply(params["sigma"], jax.lax.stop_gradient(jnp.concatenate([activity, speed], axis=-1)))
    return Sigma(
        *(low * jnp.exp(jax.nn.sigmoid(logits[..., k]) * jnp.log(high / low)) for k, (low, high) in enumerate(BOUNDS))
    )
