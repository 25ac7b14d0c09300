# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compiled functions that callers link to, instead of taking a copy of their machine code.

Numba copies a compiled function, with all that it calls, into each function that calls it, and
optimises every copy anew: for deep call trees most of the compilation. A `linked` function is
compiled once; its callers hold its symbol only. Before a caller is loaded from the cache, numba
loads what it links to.

Whoever calls a linked function must be linked as well, or be called from Python only: numba forgets
what a copy of machine code from the cache links to.
"""

from __future__ import annotations

import fcntl
import importlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from dlo_ros.kernel_cache import cache_folder, jit_disabled, njit


def linked(*, from_python: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator for a compiled function that its compiled callers link to.

    Args:
        from_python: whether Python calls it, too; for others what unpacks Python's objects is
            compiled only where that happens after all, and not kept.
        options: further options of `numba.njit`.

    Raises:
        KernelError: numba is not installed, or no folder for machine code can be written.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        compiled = njit(from_python=from_python, **options)(function)
        return compiled if jit_disabled() else LinkedKernel(compiled, from_python)

    return decorate


class LinkedKernel:
    """A compiled function, called from Python or by its symbol from compiled code.

    Args:
        dispatcher: function that `numba.njit` returned.
        from_python: whether that can be called from Python.
    """

    def __init__(self, dispatcher: Any, from_python: bool) -> None:
        self._dispatcher = dispatcher
        self.py_func = dispatcher.py_func
        self.__doc__ = dispatcher.__doc__
        self._from_python = dispatcher if from_python else None
        self._symbols: dict[tuple[Any, ...], str] = {}
        _register(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call it from Python."""
        if self._from_python is None:
            self._from_python = _caller(self)
        return self._from_python(*arguments)

    def signature(self, types: tuple[Any, ...]) -> Any:
        """Compile for types of arguments, or load from the cache; returns the signature.

        Where another process is compiling the same, its result is awaited. As there is no
        recursion, no two processes wait for each other.

        Raises:
            TypeError: it returns a tuple that it was lent, see `kernel_arguments.whole`.
        """
        from dlo_ros.kernel_arguments import is_lent

        overloads = self._dispatcher.overloads
        if types not in overloads:
            with _alone(self._symbol(types)):
                self._dispatcher.compile(types)
        signature = overloads[types].signature
        if is_lent(signature.return_type):
            raise TypeError(f"{self.py_func.__name__} returns what it was lent without `whole`")
        return signature

    def link(self, types: tuple[Any, ...]) -> str:
        """Make the machine code for types of arguments known to others; returns its symbol."""
        from llvmlite import binding

        if types not in self._symbols:
            self.signature(types)
            result = self._dispatcher.overloads[types]
            symbol = self._symbol(types)
            address = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
            binding.add_symbol(symbol, address)
            self._symbols[types] = symbol
        return self._symbols[types]

    def _symbol(self, types: tuple[Any, ...]) -> str:
        digest = sha256(str(types).encode()).hexdigest()
        return f"{self.py_func.__module__}.{self.py_func.__name__}.{digest}"


@dataclass(frozen=True)
class Link:
    """Loads what a function from the cache links to; kept beside its machine code."""

    module: str
    name: str
    types: tuple[Any, ...]

    def __call__(self) -> None:
        """Load it."""
        importlib.import_module(self.module)
        _kernels[self.module, self.name].link(self.types)


_kernels: dict[tuple[str, str], LinkedKernel] = {}
"""By module and name of the function, which may stand there under another name."""


@contextmanager
def _alone(symbol: str) -> Iterator[None]:
    """Hold a function's lock; without one where it cannot be made, as on a full disk.

    Numba's own lock is taken first: otherwise two threads could wait for each other.
    """
    from numba.core.compiler_lock import global_compiler_lock

    with ExitStack() as stack:
        stack.enter_context(global_compiler_lock)
        with suppress(OSError):
            folder = cache_folder() / "locks"
            folder.mkdir(exist_ok=True)
            lock = stack.enter_context((folder / symbol).open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _caller(kernel: LinkedKernel) -> Any:
    """A compiled function that does nothing but call a kernel; no cache keeps it."""
    import numba

    def call(*arguments):  # type: ignore[no-untyped-def]  # numba infers the types
        return kernel(*arguments)

    return numba.njit(nogil=True)(call)


def _register(kernel: LinkedKernel) -> None:
    """Register a kernel's type with numba, and the way to call it."""
    from numba import types
    from numba.core import cgutils, imputils
    from numba.core.typing import signature as signature_of
    from numba.core.typing.templates import AbstractTemplate, infer_global
    from numba.extending import lower_builtin

    from dlo_ros.kernel_arguments import handed_over, has_arrays, lent

    _kernels[kernel.py_func.__module__, kernel.py_func.__name__] = kernel
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"

    @infer_global(kernel, typing_key=name)
    class Template(AbstractTemplate):  # type: ignore[misc]  # numba carries no types
        def generic(self, args: Any, kws: Any) -> Any:
            if kws:
                return None
            return signature_of(kernel.signature(tuple(map(lent, args))).return_type, *args)

    @lower_builtin(name, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
    def call(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, result_kind = tuple(map(lent, signature.args)), signature.return_type
        symbol = kernel.link(kinds)
        convention = context.call_conv
        function = cgutils.get_or_insert_function(
            builder.module, convention.get_function_type(result_kind, kinds), symbol
        )
        counted = has_arrays(result_kind)
        arguments = [
            handed_over(context, builder, kind, value, counted=counted)
            for kind, value in zip(signature.args, arguments, strict=True)
        ]
        status, result = convention.call_function(builder, function, result_kind, kinds, arguments)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        link = Link(kernel.py_func.__module__, kernel.py_func.__name__, kinds)
        context.active_code_library._reload_init.add(link)
        return imputils.fix_returning_optional(context, builder, signature, status, result)
