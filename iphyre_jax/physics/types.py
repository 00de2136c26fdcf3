"""The data of one world: what is compiled (`Topology`), what is given (`World`, `Timing`) and what moves (`State`).

Index conventions used everywhere in `physics`:

* moving bodies: the moving bars in list order, then the balls: 0 .. n-1 (`n = bars + balls`);
* static bars: by their rank in the reference's static tree, so that index order is visiting order;
* bars: the moving ones, then the static ones.

Shapes are those of one world. Every array may carry further axes *behind* the ones given (lanes: many worlds of one
topology side by side, each operation one contiguous loop over them); `rollouts` does so.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp

from iphyre_jax.checks import check_instance, check_whole, show
from iphyre_jax.physics.order_keys import STATIC_RANKS, OrderKeyLayout
from iphyre_jax.physics.vector import Vec

STATIC = -1  # the end of a joint or spring that is held by a static bar
ABSENT = -2  # in `World.anchor_static`: the world lacks this constraint of its topology
MAX_BODIES = 15  # moving ones; the tag of a contact point has four bits for each of its two bodies
MAX_SLOTS = 1024  # of contacts


@dataclass(frozen=True)
class Topology:
    """What decides the compiled program: which bodies move and what ties them. Hashable.

    At least one body moves, and at most 15 do.

    Raises:
        ValueError: a number is out of range, or the end of a tie is no body; one line.
    """

    bars: int  # moving bars
    balls: int
    num_static: int  # room for static bars, 0 to 64; `World.valid` marks those that exist
    pins: tuple[tuple[int, int], ...]  # moving-body index or STATIC at each end, in list order
    springs: tuple[tuple[int, int], ...]
    slots: int  # contact points a world may have at once, 1 to 1024; more is a fault

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, least, most in (("bars", 0, MAX_BODIES), ("balls", 0, MAX_BODIES), ("num_static", 0, STATIC_RANKS)):
            check_whole(name, getattr(self, name), least, most)
        check_whole("slots", self.slots, 1, MAX_SLOTS)
        if not 1 <= self.moving <= MAX_BODIES:
            raise ValueError(f"bars, balls: expected 1 to {MAX_BODIES} bodies that move, got {self.moving}")
        for name in ("pins", "springs"):
            ties = check_instance(name, getattr(self, name), tuple, "a tuple of pairs of moving bodies")
            for tie in ties:
                if not isinstance(tie, tuple) or len(tie) != 2:
                    raise ValueError(f"{name}: expected pairs of moving bodies, got {show(tie)}")
                for end in tie:
                    check_whole(name, end, STATIC, self.moving - 1)

    @property
    def moving(self) -> int:
        """Number of moving bodies n."""
        return self.bars + self.balls

    @property
    def few_slots(self) -> int:
        """Contact slots that are enough nearly always; time and compile time grow with them.

        They are for all of 800,000 random plans of the forty games at 10 fps, which need at most 2 slots with one ball,
        4 with two, 8 with a bar and a ball, 9 in all other games. Of 2000 crowded random scenes 8 need more than
        `slots`.
        """
        return min(self.slots, 10, 2 * self.balls + 6 * self.bars)

    @property
    def max_steps(self) -> int:
        """Most steps of an episode: the order keys have no room for more."""
        return OrderKeyLayout(self.moving).max_steps

    @property
    def constraint_ends(self) -> tuple[tuple[int, int], ...]:
        """Pin joints, then springs: the reference's list order before any removal."""
        return self.pins + self.springs

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of moving bodies, lower index first."""
        return tuple((i, j) for i in range(self.moving) for j in range(i + 1, self.moving))

    @cached_property
    def bar_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of bars of which the first moves; bars are the moving ones, then the static ones."""
        return tuple((i, j) for i in range(self.bars) for j in range(i + 1, self.bars + self.num_static))

    @cached_property
    def ball_bar_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs (ball, bar); the ball is counted from 0."""
        return tuple((i, j) for i in range(self.balls) for j in range(self.bars + self.num_static))

    @cached_property
    def ball_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of balls, counted from 0, lower index first."""
        return tuple((i, j) for i in range(self.balls) for j in range(i + 1, self.balls))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class World:
    """The scene of one world as numbers. n moving bodies, m moving bars, S = room for static bars, P pairs."""

    start: Vec  # (n,) px, centres at the start
    radius: jax.Array  # (balls,) px
    inv_moment: jax.Array  # (n,) 1/(px^2), mass being 1
    bar_a: Vec  # (m,) px, end points of the core line in the body's frame
    bar_b: Vec
    bar_normal: Vec  # (m,) unit, body frame
    static_a: Vec  # (S,) px, world frame
    static_b: Vec
    static_normal: Vec  # (S,) unit
    static_centre: Vec  # (S,) px
    valid: jax.Array  # (S,) bool, False for unused room
    plan_slot: jax.Array  # (S,) int32, the plan's column that eliminates this bar, -1 for none
    anchor: Vec  # (constraints,) px, the static end's centre (0 where both ends move, or ABSENT)
    anchor_static: jax.Array  # (constraints,) int32, static index of that bar, -1 for none, or ABSENT
    pin_length: jax.Array  # (pins,) px
    point_class: jax.Array  # (4, bar pairs) int32, see `initial_order.point_classes`
    leaf_order: jax.Array  # (n,) int32, moving bodies in the order in which the broad phase updates them
    start_path: jax.Array  # (n,) int32, path bits in the moving tree
    start_depth: jax.Array  # (n,) int32
    static_counter: jax.Array  # (n * S,) int32, insertion counter of a body's pair with a static bar at the start
    pair_counter: jax.Array  # (P,) int32, the same of the pairs of moving bodies

    @property
    def exact(self) -> bool:
        """Whether the solver must round as the reference's (float64), or may be more accurate (float32)."""
        return self.start.exact

    @classmethod
    def shapes(cls, topology: Topology, dtype: str) -> World:
        """Return the shapes and types of the world of a topology, as `jax.ShapeDtypeStruct`; dtype: of its numbers."""
        n, m, room, ties = topology.moving, topology.bars, topology.num_static, len(topology.constraint_ends)

        def array(*shape: int, of: str = dtype) -> Any:  # noqa: ANN401 - it stands for an array
            return jax.ShapeDtypeStruct(shape, of)

        def vec(rows: int) -> Vec:
            return Vec(array(rows), array(rows))

        def whole(*shape: int) -> Any:  # noqa: ANN401
            return array(*shape, of="int32")

        return cls(
            start=vec(n),
            radius=array(topology.balls),
            inv_moment=array(n),
            bar_a=vec(m),
            bar_b=vec(m),
            bar_normal=vec(m),
            static_a=vec(room),
            static_b=vec(room),
            static_normal=vec(room),
            static_centre=vec(room),
            valid=array(room, of="bool"),
            plan_slot=whole(room),
            anchor=vec(ties),
            anchor_static=whole(ties),
            pin_length=array(len(topology.pins)),
            point_class=whole(4, len(topology.bar_pairs)),
            leaf_order=whole(n),
            start_path=whole(n),
            start_depth=whole(n),
            static_counter=whole(n * room),
            pair_counter=whole(len(topology.pairs)),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Timing:
    """Everything that follows from dt, computed on the host in float64; scalars."""

    dt: jax.Array  # s
    bias: jax.Array  # share of an overlap or a joint's error corrected in a step
    gravity_dt: jax.Array  # px/s
    spring_decay: jax.Array  # (2,) share of relative speed lost in a step, one end fixed or none


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """Velocities of the bodies, or of one; the bias velocities correct overlaps and live for one step."""

    velocity: Vec  # px/s
    angular_velocity: jax.Array  # rad/s
    bias_velocity: Vec
    bias_angular_velocity: jax.Array


Motions = list[Motion]  # one of each moving body


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Box:
    """Axis-aligned boxes, px; y points down, so `top` is the smaller y."""

    left: jax.Array
    top: jax.Array
    right: jax.Array
    bottom: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Segment:
    """A bar in the world frame: ends of its core line, px, and its unit normal."""

    a: Vec
    b: Vec
    normal: Vec


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BroadPhase:
    """The reference's broad phase as far as it decides the order of the contacts. n bodies, P pairs of them."""

    fat: Box  # (n,) boxes with a margin; a body is re-inserted when it leaves its own
    path: jax.Array  # (n,) int32, path bits in the tree of moving bodies, left-aligned
    depth: jax.Array  # (n,) int32, path bits in use
    inserted: jax.Array  # (n,) int32, counter base of the last re-insertion, -1 if never
    pair_counter: jax.Array  # (P,) int32
    updated: jax.Array  # (n,) bool, re-inserted in this step


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cache:
    """Impulses of the contact points of the last three steps, newest first. K slots."""

    point: jax.Array  # (3, K) int32, identity of the point: 4 * pair + id class; -1 for an empty slot
    normal_impulse: jax.Array  # (3, K) px/s
    tangent_impulse: jax.Array  # (3, K)

    def with_slots(self, slots: int) -> Cache:
        """Return it with so many slots: without the last ones, or with empty ones behind."""

        def resized(rows: jax.Array, empty: int) -> jax.Array:
            more = max(0, slots - rows.shape[1])
            return jnp.pad(rows[:, :slots], [(0, 0), (0, more), *[(0, 0)] * (rows.ndim - 2)], constant_values=empty)

        return Cache(resized(self.point, -1), resized(self.normal_impulse, 0), resized(self.tangent_impulse, 0))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """All that the next step needs of one world, and nothing that can be computed."""

    position: Vec  # (n,) px
    position_compensation: Vec  # (n,) px, what float32 rounded off (Kahan's sum); float64: no rows
    angle: jax.Array  # (n,) rad
    motion: Motion  # (n,)
    alive: jax.Array  # (S,) bool, static bars still there
    broad: BroadPhase
    gjk_start: jax.Array  # (bar pairs,) int32, side at which the last search ended (`gjk`); float32: no rows
    cache: Cache
    pin_impulse: jax.Array  # (pins,) px/s
    constraint_rank: jax.Array  # (constraints,) int32, in the reference's list, -1 for none; (0,) with fewer than 3
    step: jax.Array  # () int32, steps made
    overflow: jax.Array  # () bool, a step had more contact points than slots


_PARTS = {"topology": Topology, "world": World, "timing": Timing, "state": State}


def check_parts(**parts: object) -> None:
    """Check the parts of a world by name: topology, world, timing and state; the world's shapes if there is a topology.

    Raises:
        ValueError: one has another class or dtype, JAX lacks its dtype, or the world is of another topology; one line.
    """
    for name, part in parts.items():
        check_instance(name, part, _PARTS[name], f"a {_PARTS[name].__name__} of iphyre_jax.physics")
    _check_dtypes(**parts)
    topology, world = parts.get("topology"), parts.get("world")
    if not isinstance(topology, Topology) or not isinstance(world, World):
        return
    expected = World.shapes(topology, "float32")
    for field in fields(World):
        of_topology, given = (jax.tree.leaves(getattr(each, field.name)) for each in (expected, world))
        for one, leaf in zip(of_topology, given, strict=True):
            if jnp.shape(leaf)[: len(one.shape)] != one.shape:
                wanted = f"shape {one.shape} (and lanes behind) of {field.name}, by the topology"
                raise ValueError(f"world: expected {wanted}, got {jnp.shape(leaf)}")


def _check_dtypes(**parts: object) -> None:
    """Refuse parts whose floating-point numbers are of several types, or of one that JAX would turn into another."""
    found = [
        (name, leaf.dtype.name)
        for name, part in parts.items()
        for leaf in (jax.tree.leaves(part) if name != "topology" else ())
        if hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.floating)
    ]
    for name, dtype in found:
        if jax.dtypes.canonicalize_dtype(dtype) != dtype:
            raise ValueError(f"{name}: expected jax.enable_x64(True) around {dtype}, or one made with float32")
        if dtype != found[0][1]:
            raise ValueError(f"{name}: expected dtype {found[0][1]}, as the {found[0][0]} has, got {dtype}")
