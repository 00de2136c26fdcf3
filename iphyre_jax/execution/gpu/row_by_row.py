"""Traced functions evaluated row by row: every number of a lane becomes a value of its own.

A thread of a GPU keeps its numbers in registers, and registers have no index. So a kernel cannot work on tables,
(rows, *lanes). Here a function is traced as it stands, and its operations are done again on the numbers alone: an array
of a table's shape becomes a NumPy array of objects, one a row, each of them (block,) over lanes, or () if all lanes
have it. What only moves rows about, such as a slice, costs nothing. A row whose number is traced takes branches, or a
select a row.

It knows the operations that the physics is made of, no more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from iphyre_jax.execution.gpu.rows import MOVES, Values, has_lanes, is_known, known_values, rows_of, spread, values

FEW_NUMBERS: Final = 4  # of a row, which are selected without a branch
Operation = Callable[..., Any]

# Operations on numbers, each lane by itself.
_OF_NUMBERS: Final = frozenset(
    (
        *("abs", "add", "and", "bitcast_convert_type", "clamp", "clz", "convert_element_type", "cos", "div", "eq"),
        *("ge", "gt", "is_finite", "le", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "population_count"),
        *("select_n", "shift_left", "shift_right_arithmetic", "sin", "sqrt", "sub", "xor"),
    )
)
# What NumPy computes if all numbers are known, with the same roundings.
_OF_KNOWN: Final[Mapping[str, Operation]] = {
    "abs": np.abs,
    "add": np.add,
    "and": np.bitwise_and,
    "eq": np.equal,
    "ge": np.greater_equal,
    "gt": np.greater,
    "le": np.less_equal,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "not": np.invert,
    "or": np.bitwise_or,
    "shift_left": np.left_shift,
    "sub": np.subtract,
    "xor": np.bitwise_xor,
}


def evaluate(traced: ClosedJaxpr, arguments: Sequence[Values], block: int, zero: jax.Array) -> list[Values]:
    """Return the results of a traced function; traced itself.

    Args:
        traced: the function, with LANES lanes.
        arguments: its arguments.
        block: lanes of the numbers.
        zero: () int32, 0, which the compiler must not know.

    Raises:
        NotImplementedError: the function has an operation that is not known here.
    """
    return _Evaluation(block, zero).run(traced, arguments)


class _Evaluation:
    """The evaluation of one function."""

    def __init__(self, block: int, zero: jax.Array) -> None:
        self.block, self.zero = block, zero
        # By the name of JAX's operation, on arrays.
        self.operations: dict[str, Operation] = {
            **MOVES,
            "cond": self._cond,
            "cumsum": self._cumsum,
            "dynamic_slice": self._dynamic_slice,
            "dynamic_update_slice": self._dynamic_update_slice,
            "jit": self._jit,
            "reduce_and": partial(self._reduce, jax.lax.and_p),
            "reduce_max": partial(self._reduce, jax.lax.max_p),
            "reduce_min": partial(self._reduce, jax.lax.min_p),
            "reduce_or": partial(self._reduce, jax.lax.or_p),
            "reduce_sum": partial(self._reduce, jax.lax.add_p),
            "scan": self._scan,
            "while": self._while,
        }

    def run(self, traced: ClosedJaxpr, arguments: Sequence[Values]) -> list[Values]:
        """Return the results of a function."""
        jaxpr: Any = traced.jaxpr
        known: dict[Any, Values] = {}

        def read(var: Any) -> Values:  # noqa: ANN401
            dtype = var.aval.dtype
            return known_values(np.asarray(var.val, dtype)) if isinstance(var, Literal) else known[var]

        known.update(zip(jaxpr.constvars, map(known_values, traced.consts), strict=True))
        known.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            known.update(zip(equation.outvars, self._operate(list(map(read, equation.invars)), equation), strict=True))
        return list(map(read, jaxpr.outvars))

    def _operate(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        """Return the results of an operation, whatever it is."""
        primitive = equation.primitive
        work = self.operations.get(primitive.name)
        if primitive.name in _OF_NUMBERS:
            work = partial(self._number_by_number, primitive)
        if work is None:
            raise NotImplementedError(f"operation {primitive.name} in a kernel")
        try:
            results: list[Values] = work(given, equation)
        except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
            raise NotImplementedError(f"operation {primitive.name} of this form in a kernel ({error})") from error
        shapes = [var.aval.shape for var in equation.outvars]
        if [one.shape for one in results] != list(map(rows_of, shapes)):
            raise NotImplementedError(f"operation {primitive.name} with results of shapes {shapes} in a kernel")
        return results

    # Numbers

    def _number_by_number(self, primitive: Any, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        out, params = equation.outvars[0].aval, equation.params
        if has_lanes(out.shape):  # an axis of length 1 stands for lanes too
            pairs = zip(given, equation.invars, strict=True)
            given = [
                one.reshape(one.shape[:-1]) if one.ndim == out.ndim and not has_lanes(var.aval.shape) else one
                for one, var in pairs
            ]
        rows = np.broadcast_arrays(*given, np.empty(rows_of(out.shape)))[:-1]
        numbers = zip(*(one.reshape(-1) for one in rows), strict=True)
        return [values(rows_of(out.shape), [self._compute(primitive, params, row) for row in numbers])]

    def _compute(self, primitive: Any, params: Mapping[str, Any], given: Sequence[Any]) -> Any:  # noqa: ANN401
        """Return the result of an operation on numbers."""
        name = primitive.name
        if name == "select_n" and len(given) == 3:
            if is_known(given[0]):
                return given[1 + int(given[0])]
            if given[1] is given[2]:
                return given[1]
        if all(map(is_known, given)):
            if name in _OF_KNOWN:
                return _OF_KNOWN[name](*given)
            if name == "convert_element_type":
                return given[0].astype(params["new_dtype"])
            given = [self._number(one, one.dtype) for one in given]
        if name in ("and", "or") and any(isinstance(one, np.bool_) for one in given):
            decided = given[0] if isinstance(given[0], np.bool_) else given[1]
            other = given[1] if decided is given[0] else given[0]
            return other if bool(decided) == (name == "and") else decided
        if any(jnp.ndim(one) for one in given):
            given = [one if jnp.ndim(one) else spread(one, one.dtype, self.block) for one in given]
        given = [jax.lax.full((), one, one.dtype) if is_known(one) else one for one in given]
        return primitive.bind(*given, **params)

    def _select(self, condition: Any, yes: Any, no: Any) -> Any:  # noqa: ANN401
        return self._compute(jax.lax.select_n_p, {}, (condition, no, yes))

    def _jit(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        return self.run(equation.params["jaxpr"], given)

    # Rows whose number is traced

    def _dynamic_slice(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        table = given[0]
        for axis, size in enumerate(equation.params["slice_sizes"][: table.ndim]):
            if size != table.shape[axis]:
                table = self._rows_from(np.moveaxis(table, axis, 0), given[1 + axis].item(), size)
                table = np.moveaxis(table, 0, axis)
        return [table]

    def _rows_from(self, table: Values, first: Any, size: int) -> Values:  # noqa: ANN401
        last = len(table) - size
        if is_known(first):
            start = min(max(int(first), 0), last)
            return table[start : start + size]
        if size != 1:
            raise NotImplementedError("several rows at once from a traced row in a kernel")
        rows = table.reshape(len(table), -1)
        chosen = self._choose(list(rows), first, 0)
        return values((1, *table.shape[1:]), chosen)

    def _choose(self, rows: Sequence[Values], number: jax.Array, first: int) -> Sequence[Any]:
        """Return the row of a number, which lies between `first` and the last row, or means the nearer of these."""
        if len(rows) == 1:
            return list(rows[0])
        middle = len(rows) // 2
        if len(rows[0]) <= FEW_NUMBERS:
            below = self._choose(rows[:middle], number, first)
            above = self._choose(rows[middle:], number, first + middle)
            here = number >= first + middle
            return [self._select(here, yes, no) for yes, no in zip(above, below, strict=True)]
        # A branch costs less than to select each of many numbers. What is the same in all rows stays out of it.
        common = [all(row[k] is rows[0][k] for row in rows) for k in range(len(rows[0]))]
        laned = [any(jnp.ndim(row[k]) for row in rows) for k in range(len(rows[0]))]

        def leaves(part: Sequence[Values], start: int) -> list[jax.Array]:
            row = self._choose(part, number, start)
            return [
                spread(one, one.dtype, self.block) if wide else self._number(one, one.dtype)
                for one, wide, same in zip(row, laned, common, strict=True)
                if not same
            ]

        halves = ((rows[middle:], first + middle), (rows[:middle], first))
        taken = iter(jax.lax.cond(number >= first + middle, *(partial(leaves, *half) for half in halves)))
        return [rows[0][k] if same else next(taken) for k, same in enumerate(common)]

    def _dynamic_update_slice(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        table, update, *starts = given
        axes = [axis for axis in range(table.ndim) if update.shape[axis] != table.shape[axis]]
        if not axes:
            return [update]
        if len(axes) > 1 or update.shape[axes[0]] != 1:
            raise NotImplementedError("several rows at once into a traced row in a kernel")
        axis, first = axes[0], starts[axes[0]].item()
        rows = np.moveaxis(table, axis, 0)
        out, new = rows.reshape(len(rows), -1).copy(), np.moveaxis(update, axis, 0).reshape(-1)
        last = len(rows) - 1
        at = np.clip(first, 0, last) if is_known(first) else jnp.clip(first, 0, last)
        for k, old in enumerate(out):
            here = at == k
            out[k] = values(old.shape, [self._select(here, one, other) for one, other in zip(new, old, strict=True)])
        return [np.moveaxis(out.reshape(rows.shape), 0, axis)]

    # Sums over rows, and over lanes

    def _reduce(self, primitive: Any, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        table, axes = given[0], equation.params["axes"]
        over_rows, rest = [k for k in axes if k < table.ndim], [k for k in range(table.ndim) if k not in axes]
        rows = table.transpose(*rest, *over_rows).reshape([table.shape[k] for k in rest] + [-1])
        out = [
            reduce(lambda one, other: self._compute(primitive, {}, (one, other)), list(rows[index]))
            for index in np.ndindex(*rows.shape[:-1])
        ]
        if has_lanes(equation.invars[0].aval.shape) and table.ndim in axes:
            out = [_over_lanes(primitive.name, number) for number in out]
        return [values(rows.shape[:-1], out)]

    def _cumsum(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        axis = equation.params["axis"]
        if equation.params["reverse"]:
            raise NotImplementedError("a sum from behind in a kernel")
        rows = np.moveaxis(given[0], axis, 0)
        out = rows.reshape(len(rows), -1).copy()
        for k in range(1, len(rows)):
            pairs = zip(out[k - 1], out[k], strict=True)
            out[k] = values(out[k].shape, [self._compute(jax.lax.add_p, {}, pair) for pair in pairs])
        return [np.moveaxis(out.reshape(rows.shape), 0, axis)]

    # Loops and branches

    def _while(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        params, outs = equation.params, equation.outvars
        of_condition, of_body = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]

        def goes_on(leaves: Sequence[jax.Array]) -> jax.Array:
            carry = self._joined(leaves, outs)
            return self._number(self.run(params["cond_jaxpr"], [*given[:of_condition], *carry])[0].item(), np.bool_)

        def body(leaves: Sequence[jax.Array]) -> Sequence[jax.Array]:
            carry = self._joined(leaves, outs)
            return self._leaves(self.run(params["body_jaxpr"], [*given[of_condition:of_body], *carry]), outs)

        return self._joined(jax.lax.while_loop(goes_on, body, self._leaves(given[of_body:], outs)), outs)

    def _scan(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        params, outs = equation.params, equation.outvars
        consts = len(given) - len(outs)
        inner = params["jaxpr"].jaxpr
        pairs = ((inner.invars, equation.invars), (inner.outvars, outs), (inner.invars[consts:], outs))
        if any([one.aval.shape for one in own] != [one.aval.shape for one in around] for own, around in pairs):
            raise NotImplementedError("a scan over rows in a kernel")

        def body(_: jax.Array, leaves: list[jax.Array]) -> list[jax.Array]:
            return self._leaves(self.run(params["jaxpr"], [*given[:consts], *self._joined(leaves, outs)]), outs)

        return self._joined(jax.lax.fori_loop(0, params["length"], body, self._leaves(given[consts:], outs)), outs)

    def _cond(self, given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
        index, branches, outs = given[0].item(), equation.params["branches"], equation.outvars
        if is_known(index):
            return self.run(branches[min(max(int(index), 0), len(branches) - 1)], given[1:])
        works = [lambda branch=branch: self._leaves(self.run(branch, given[1:]), outs) for branch in branches]
        return self._joined(jax.lax.switch(index, works), outs)

    def _number(self, number: Any, dtype: Any) -> jax.Array:  # noqa: ANN401
        """Return a number that all lanes have as a traced one: a loop takes no number that is known."""
        if not is_known(number):
            return cast(jax.Array, number)
        if dtype == np.bool_:
            return self.zero == 0 if number else self.zero != 0
        return jnp.subtract(np.asarray(number, dtype)[()], self.zero.astype(dtype))  # -0.0 stays

    def _leaves(self, tables: Sequence[Values], outs: Sequence[Any]) -> list[jax.Array]:
        """Return the numbers of arrays, one after another, as a loop or a branch takes them."""
        return [
            spread(number, var.aval.dtype, self.block)
            if has_lanes(var.aval.shape)
            else self._number(number, var.aval.dtype)
            for table, var in zip(tables, outs, strict=True)
            for number in np.ravel(table)
        ]

    def _joined(self, leaves: Sequence[jax.Array], outs: Sequence[Any]) -> list[Values]:
        """Return arrays of the numbers that `_leaves` gave."""
        out, start = [], 0
        for var in outs:
            shape = rows_of(var.aval.shape)
            out.append(values(shape, leaves[start : start + math.prod(shape)]))
            start += math.prod(shape)
        return out


def _over_lanes(name: str, number: Any) -> Any:  # noqa: ANN401
    """Return what an operation makes of the numbers of all lanes, ()."""
    if jnp.ndim(number) == 0 and name != "add":
        return number
    if name not in (("and", "or", "max", "min") if number.dtype == np.bool_ else ("max", "min")):
        raise NotImplementedError(f"operation {name} over lanes of {number.dtype} in a kernel")
    whole = number.astype(jnp.int32) if number.dtype == np.bool_ else number
    out = jnp.max(whole) if name in ("or", "max") else jnp.min(whole)
    return out != 0 if number.dtype == np.bool_ else out
