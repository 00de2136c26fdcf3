"""The rules of a valid scene. Each wrong field gets one line that names it and says what was expected.

The rules come in layers: types, sizes, flags, pairs. A layer runs only if the layers before it found nothing. So each
mistake is reported once, and later rules can rely on earlier ones.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final

from iphyre_jax.checks import show
from iphyre_jax.scenes.errors import raise_problems
from iphyre_jax.scenes.limits import MAX_MOVING, MIN_LENGTH, Limits
from iphyre_jax.scenes.parse import OPTIONAL, REQUIRED, Pair, RawScene, parse_scene

Labels = Mapping[str, str]

FILE_LABELS: Final[Labels] = {key: key for key in REQUIRED + OPTIONAL}
"""For scene files, error messages use the names in the file."""


def check_scene(
    fields: Mapping[str, object], source: str, labels: Labels = FILE_LABELS, limits: Limits | None = None
) -> RawScene:
    """Validate a scene in full.

    Args:
        fields: `name`, `block`, `ball`, `eli`, `dynamic` and optionally `joint`, `spring` and `limits`, as plain
            numbers, text, lists and objects.
        source: the file or argument that error messages name.
        labels: the name of each field in error messages.
        limits: of the scene; they replace its field "limits".

    Returns:
        The parsed and valid fields.

    Raises:
        ValueError: fields are wrong; one line for each, "source: field: expected ..., got ...".
    """
    raw, problems = parse_scene(fields, labels, limits)
    for rules in (_sizes, _flags, _pairs):
        raise_problems(source, problems)
        problems = list(rules(raw, labels))
    raise_problems(source, problems)
    return raw


def _sizes(raw: RawScene, labels: Labels) -> Iterator[str]:
    """Check the number of objects and the size of each."""
    bars, balls = len(raw.blocks), len(raw.balls)
    if not balls:
        yield f"{labels['ball']}: expected at least one ball, got none"
    if bars + balls > (most := raw.limits.objects):
        yield f"{labels['block']}: expected at most {most} objects, got {bars} blocks and {balls} balls"
    for key, flags in (("eli", raw.eliminable), ("dynamic", raw.dynamic)):
        if len(flags) != bars + balls:
            wanted = f"{bars + balls} entries (one for each of {bars} blocks and {balls} balls)"
            yield f"{labels[key]}: expected {wanted}, got {len(flags)}"
    for i, (start, end) in enumerate(raw.blocks):
        if (length := math.dist(start, end)) < MIN_LENGTH:
            yield f"{labels['block']}[{i}]: expected end points at least {MIN_LENGTH:g} px apart, got {length:g} px"
    for i, (_, _, radius) in enumerate(raw.balls):
        if radius < MIN_LENGTH:
            yield f"{labels['ball']}[{i}][2]: expected a radius of at least {MIN_LENGTH:g} px, got {radius:g}"


def _flags(raw: RawScene, labels: Labels) -> Iterator[str]:
    """Check that balls move and stay, and that only static bars, not too many, can be eliminated."""
    for i, (eliminable, dynamic) in enumerate(zip(raw.eliminable, raw.dynamic, strict=True)):
        is_ball = i >= len(raw.blocks)
        if is_ball and eliminable:
            yield f"{labels['eli']}[{i}]: expected 0 (object {i} is a ball, which cannot be eliminated), got 1"
        if is_ball and not dynamic:
            yield f"{labels['dynamic']}[{i}]: expected 1 (object {i} is a ball, which always moves), got 0"
        if eliminable and dynamic and not is_ball:
            yield f"{labels['eli']}[{i}]: expected 0 (block {i} is dynamic; only a static one can be eliminated), got 1"
    if (moving := sum(raw.dynamic)) > MAX_MOVING:
        yield f"{labels['dynamic']}: expected at most {MAX_MOVING} objects that move, got {moving}"
    if (count := sum(raw.eliminable)) > (most := raw.limits.blocks):
        yield f"{labels['eli']}: expected at most {most} eliminable blocks, got {count}"


def _pairs(raw: RawScene, labels: Labels) -> Iterator[str]:
    """Check that each joint and spring connects two different objects, one of which moves, and no pair twice."""
    for key, pairs in (("joint", raw.joints), ("spring", raw.springs)):
        label = labels[key]
        first: dict[frozenset[int], int] = {}
        for i, pair in enumerate(pairs):
            problem = _pair_problem(raw, pair, is_pin=key == "joint")
            if problem:
                yield f"{label}[{i}]{problem}"
            elif frozenset(pair) in first:
                yield f"{label}[{i}]: expected each pair once, got that of {label}[{first[frozenset(pair)]}] again"
            else:
                first[frozenset(pair)] = i


def _pair_problem(raw: RawScene, pair: Pair, is_pin: bool) -> str:
    """Return the error of one pair, as the end of a line that begins with its name; empty if the pair is valid."""
    last = len(raw.dynamic) - 1
    for i, index in enumerate(pair):
        if not 0 <= index <= last:
            return f"[{i}]: expected an object index from 0 to {last}, got {show(index)}"
    a, b = pair
    if a == b:
        return f": expected two different objects, got {a} twice"
    if not (raw.dynamic[a] or raw.dynamic[b]):
        return f": expected at least one object that moves, got the static blocks {a} and {b}"
    if is_pin and (apart := math.dist(raw.centre(a), raw.centre(b))) < MIN_LENGTH:
        # A pin joint acts from centre to centre; without a distance it has no direction.
        return f": expected two centres at least {MIN_LENGTH:g} px apart, got {apart:g} px between {a} and {b}"
    return ""
