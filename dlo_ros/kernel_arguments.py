# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Named tuples as arguments of linked functions: a pointer instead of all their numbers.

Numba hands over an array as seven numbers or more, and a rod has a hundred arrays: calls would take
longer than what is called. A linked function gets a pointer to a copy of its caller's tuple and
loads what it uses; handed on, that stays the same pointer.

The caller keeps the arrays and the copy until the function returns. What comes out of a tuple that
is lent is what would come out of the tuple itself.
"""

from __future__ import annotations

from typing import Any, TypeVar

from llvmlite import ir
from numba import types
from numba.core import cgutils, imputils
from numba.core.typeconv import Conversion
from numba.core.typing import signature
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    infer_getattr,
    infer_global,
)
from numba.extending import (
    lower_builtin,
    lower_cast,
    lower_getattr_generic,
    models,
    register_model,
)

Tuple = TypeVar("Tuple")

IN_REGISTERS = 4
"""Numbers of a tuple that are handed over as they are."""


class Lent(types.Type):  # type: ignore[misc]  # numba carries no types
    """Type of a pointer to a named tuple.

    Args:
        whole: type of the tuple.
    """

    def __init__(self, whole: Any) -> None:
        self.whole = whole
        super().__init__(name=f"Lent({whole})")

    @property
    def key(self) -> Any:
        """The tuple's type, by which two of them differ."""
        return self.whole

    def unify(self, _: Any, other: Any) -> Any:
        """Type of a variable that holds one or the other: the tuple."""
        return self.whole if other == self.whole else None

    def can_convert_to(self, _: Any, other: Any) -> Any:
        """The tuple takes its place."""
        return Conversion.safe if other == self.whole else None


@register_model(Lent)
class LentModel(models.PrimitiveModel):  # type: ignore[misc]
    """It is a pointer."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, manager.lookup(kind.whole).get_value_type().as_pointer())


@infer_getattr
class LentAttributes(AttributeTemplate):  # type: ignore[misc]
    """It has the tuple's fields."""

    key = Lent

    def generic_resolve(self, kind: Any, name: str) -> Any:
        """Type of a field."""
        fields = kind.whole.fields
        return kind.whole.types[fields.index(name)] if name in fields else None


@lower_getattr_generic(Lent)  # type: ignore[untyped-decorator]
def _get_field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    k = kind.whole.fields.index(name)
    field = _loaded(builder, cgutils.gep_inbounds(builder, value, 0, k))
    return imputils.impl_ret_borrowed(context, builder, kind.whole.types[k], field)


@lower_cast(Lent, types.BaseNamedTuple)  # type: ignore[untyped-decorator]
def _get_all(context: Any, builder: Any, kind: Any, other: Any, value: Any) -> Any:
    return _loaded(builder, value)


def whole(argument: Tuple) -> Tuple:
    """An argument that is to be part of another tuple, which may outlive the function."""
    return argument


@infer_global(whole)
class _Whole(AbstractTemplate):  # type: ignore[misc]
    def generic(self, args: Any, kws: Any) -> Any:
        """Signature: the result is the tuple."""
        (kind,) = args
        return signature(kind.whole if isinstance(kind, Lent) else kind, kind)


@lower_builtin(whole, types.Any)  # type: ignore[untyped-decorator]
def _get_whole(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    value = context.cast(builder, args[0], sig.args[0], sig.return_type)
    return imputils.impl_ret_borrowed(context, builder, sig.return_type, value)


def _loaded(builder: Any, pointer: Any) -> Any:
    """A pointer's value, number by number: the compiler leaves out those that nobody uses.

    It is told that they do not change, so that it loads none again after a write to an array.
    """
    kind = pointer.type.pointee
    if not isinstance(kind, ir.Aggregate):
        number = builder.load(pointer)
        number.set_metadata("invariant.load", builder.module.add_metadata([]))
        return number
    value = ir.Constant(kind, ir.Undefined)
    for k in range(len(kind)):
        part = _loaded(builder, cgutils.gep_inbounds(builder, pointer, 0, k))
        value = builder.insert_value(value, part, k)
    return value


def lent(kind: Any) -> Any:
    """The type that a linked function has for an argument of a type."""
    named = isinstance(kind, types.BaseNamedTuple)
    return Lent(kind) if named and _numbers(kind) > IN_REGISTERS else kind


def _numbers(kind: Any) -> int:
    """Numbers of a value; an array has some for its place and its axes."""
    if isinstance(kind, types.BaseTuple):
        return sum(map(_numbers, kind))
    return 5 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


def is_lent(kind: Any) -> bool:
    """Whether a value of a type is lent, or holds what is."""
    if isinstance(kind, types.BaseTuple):
        return any(is_lent(part) for part in kind)
    return isinstance(kind, Lent)


def has_arrays(kind: Any) -> bool:
    """Whether a value of a type may refer to an array."""
    if isinstance(kind, types.BaseTuple):
        return any(has_arrays(part) for part in kind)
    return isinstance(kind, types.Array)


def handed_over(context: Any, builder: Any, kind: Any, value: Any, *, counted: bool) -> Any:
    """An argument of a type as a linked function takes it.

    Args:
        counted: whether what comes back may refer to its arrays; if not, the caller's references do
            for the function, which need not count its own.
    """
    if not counted:
        value = _uncounted(context, builder, kind, value)
    if lent(kind) == kind:
        return value
    room = cgutils.alloca_once(builder, value.type)
    builder.store(value, room)
    return room


def _uncounted(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """A value whose arrays nobody owns."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = ir.Constant(array.meminfo.type, None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind):
            if has_arrays(part):
                old = builder.extract_value(value, k)
                value = builder.insert_value(value, _uncounted(context, builder, part, old), k)
    return value
