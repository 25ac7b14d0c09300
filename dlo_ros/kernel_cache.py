# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The folder of compiled kernels, and the decorator that puts them there.

Numba notices a change of the file that a compiled function stands in, but not of the functions that
it calls. The name of the folder therefore holds a digest of all sources with compiled functions and
of numba's version, wherever the folder lies; folders of other digests are removed. A folder that
cannot be written serves as well where an administrator has had everything compiled.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any

from dlo_ros.errors import KernelError
from dlo_ros.kernel_parts import STAGES

PACKAGE = Path(__file__).parent
COMPILED = (b"njit(", b"@linked(", b"@intrinsic")
IMPORT = re.compile(rb"^from dlo_ros\.([\w.]+) import", re.MULTILINE)
PREFIX = "dlo_ros"
DIGITS = 16
"""Hexadecimal digits of a digest in a name."""

NUMBA_MISSING = "numba is not installed; pip install numba (Ubuntu 24.04 has no package of it)"

_decorating = Lock()


def njit(
    *, from_python: bool = True, constants: bool = False, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """Numba's decorator `njit`, which keeps the machine code in `cache_folder()`.

    Compiled functions release the interpreter's lock. Where the folder cannot be written, what is
    not in it is compiled for this process alone. What would call them from C is left out.

    Args:
        from_python: whether Python calls the function. What unpacks Python's objects, often more
            code than the function itself, is left out otherwise.
        constants: whether it is compiled anew for each constant with which compiled code calls it.
        options: further options of `numba.njit`.

    Raises:
        KernelError: numba is not installed, or no folder can be used.
    """
    numba = _numba()
    if numba.config.DISABLE_JIT:
        return numba.njit(**options)  # type: ignore[no-any-return]
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": not from_python}

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = kept(function)
        if not constants:
            _without_constants(dispatcher)
        return dispatcher

    def kept(function: Callable[..., Any]) -> Any:
        folder = cache_folder()
        with _decorating:
            chosen = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = str(folder)
            try:
                if writable(folder):
                    return numba.njit(cache=True, nogil=True, **options)(function)
                dispatcher = numba.njit(nogil=True, **options)(function)
                dispatcher._cache = _read_only_cache(function)
                return dispatcher
            finally:
                numba.config.CACHE_DIR = chosen

    return decorate


def _without_constants(dispatcher: Any) -> None:
    """Let a function be typed by the kind of its arguments alone.

    Numba compiles a function once more for each constant that a caller names. Where it matters,
    LLVM sees the constant anyway once it has copied the function into its caller.
    """
    from numba.core.types import unliteral  # type: ignore[attr-defined]

    template = dispatcher.get_call_template

    def without(args: Any, kws: Any) -> Any:
        return template(tuple(map(unliteral, args)), {k: unliteral(x) for k, x in kws.items()})

    dispatcher.get_call_template = without


def _read_only_cache(function: Callable[..., Any]) -> Any:
    """Numba's cache of a function in numba's configured folder, which is read but never written."""
    from numba.core import caching

    implementation = caching.FunctionCache._impl_class
    configured = implementation._locator_classes[0]

    class Locator(configured):  # type: ignore[misc, valid-type]  # numba carries no types
        def ensure_cache_path(self) -> None:
            """Numba asks here whether the folder can be written."""

    class Implementation(implementation):  # type: ignore[misc, valid-type]
        _locator_classes = (Locator,)

    class ReadOnlyCache(caching.FunctionCache):  # type: ignore[misc]
        _impl_class = Implementation

        def save_overload(self, sig: Any, data: Any) -> None:
            """It stays in this process."""

    return ReadOnlyCache(function)


@cache
def cache_folder() -> Path:
    """The folder of this installation's machine code, which exists; see `writable`.

    It lies in `NUMBA_CACHE_DIR` if that is set, otherwise in the package, and in the user's cache
    where the installation is read-only and without machine code.

    Raises:
        KernelError: numba is not installed, or no folder can be used.
    """
    numba = _numba()
    return find_folder(PACKAGE, numba.config.CACHE_DIR, source_digest(PACKAGE))


def find_folder(package: Path, chosen: str, digest: str) -> Path:
    """Find or make a folder for machine code, and remove those of older sources.

    A folder that cannot be written is taken if everything is compiled in it, and if something is
    where nothing can be written at all.

    Args:
        package: folder of the package's sources.
        chosen: numba's configured cache folder, or empty.
        digest: `source_digest` of the package.

    Raises:
        KernelError: no folder can be written, and none holds machine code.
    """
    place = sha256(str(package.resolve()).encode()).hexdigest()[:DIGITS]
    name = f"{PREFIX}-{place}-{digest}"
    own = package / "__pycache__"
    parents = _parents(package, chosen)
    parts = [part.name for stage in STAGES.values() for part in stage]
    for parent in parents:
        folder = parent / name
        fresh = not folder.exists()
        if _writable(folder):
            if fresh:
                # Elsewhere than in the package itself, other installations have folders, too.
                others = f"{PREFIX}-*" if parent == own else f"{PREFIX}-{place}-*"
                for old in parent.glob(others):
                    if not old.name.endswith(f"-{digest}"):
                        shutil.rmtree(old, ignore_errors=True)
            return folder
        if all(is_file(mark(folder, part)) for part in parts):
            return folder
    for parent in parents:
        if any(is_file(mark(parent / name, part)) for part in parts):
            return parent / name
    raise KernelError(unwritable(package, chosen))


def unwritable(package: Path, chosen: str) -> str:
    """Advice where no folder for machine code can be written, one line; see `find_folder`."""
    if chosen:
        return (
            f"NUMBA_CACHE_DIR is {chosen}, which cannot be written; name a folder for compiled "
            "code that can"
        )
    places = " nor ".join(str(parent) for parent in _parents(package, chosen))
    return (
        f"compiled code can be kept neither in {places}; "
        "set NUMBA_CACHE_DIR to a folder that can be written"
    )


def require_writable(folder: Path) -> None:
    """Refuse to compile into a folder that can only be read.

    Raises:
        KernelError: `folder`, the `cache_folder()`, cannot be written.
    """
    if not writable(folder):
        raise KernelError(unwritable(PACKAGE, _numba().config.CACHE_DIR))


@cache
def writable(folder: Path) -> bool:
    """Whether machine code can be kept in a folder, as it was when that was first asked."""
    return _writable(folder)


def mark(folder: Path, part: str) -> Path:
    """The file that says that the machine code of a part is complete, for this machine."""
    return folder / f"{part}-{machine()}.complete"


def is_file(path: Path) -> bool:
    """Whether there is such a file, as far as one may look."""
    try:
        return path.is_file()
    except OSError:  # a folder on the way is closed to this user
        return False


def source_digest(package: Path) -> str:
    """A digest of all that machine code is made from, and of numba's version.

    These are the sources with compiled functions and those that they import from, which may hold
    constants and the fields of named tuples.
    """
    import llvmlite

    texts = {source: source.read_bytes() for source in package.rglob("*.py")}
    compiled = [text for text in texts.values() if any(word in text for word in COMPILED)]
    imported = {
        package / f"{name.decode().replace('.', '/')}.py"
        for text in compiled
        for name in IMPORT.findall(text)
    }
    digest = sha256(f"{_numba().__version__} {llvmlite.__version__}".encode())
    for source in sorted(texts):
        if texts[source] in compiled or source in imported:
            digest.update(texts[source])
    return digest.hexdigest()[:DIGITS]


@cache
def machine() -> str:
    """Properties of Python and processor that machine code depends on besides its sources."""
    from llvmlite import binding

    config = _numba().config
    processor = config.CPU_NAME or binding.get_host_cpu_name()
    features = config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    text = f"{sys.implementation.cache_tag} {platform.machine()} {processor} {features}"
    return sha256(text.encode()).hexdigest()[:DIGITS]


def jit_disabled() -> bool:
    """Whether NUMBA_DISABLE_JIT has all run as plain Python.

    Raises:
        KernelError: numba is not installed.
    """
    return bool(_numba().config.DISABLE_JIT)


def _numba() -> Any:
    try:
        import numba
    except ModuleNotFoundError as err:
        if err.name not in ("numba", "llvmlite"):
            raise
        raise KernelError(NUMBA_MISSING) from err
    return numba


def _parents(package: Path, chosen: str) -> list[Path]:
    """Folders in which the cache may lie, the best place first."""
    return [Path(chosen)] if chosen else [package / "__pycache__", *_user_caches()]


def _user_caches() -> list[Path]:
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    if chosen:
        return [Path(chosen) / "dlo_ros"]
    try:
        return [Path.home() / ".cache" / "dlo_ros"]
    except RuntimeError:  # nobody knows this user
        return []


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
