# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Keep numba's cache true to the sources, and say so where compiling takes long.

Numba notices a change of the file that a compiled function stands in, but not of the functions that
it calls, and it cannot read an index whose types have moved. So whenever any source with compiled
functions has changed, all that was compiled is discarded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

PACKAGE = Path(__file__).parent
CACHES = ("*.nbi", "*.nbc")
COMPILED = (b"@njit", b"@intrinsic")
MARK = "sources.sha256"
LONG = 2.0  # [s]; loading from the cache takes a fifth of it
NOTICE = "compiling numerical kernels, once; this takes some minutes"


def discard_stale(package: Path = PACKAGE) -> bool:
    """Remove compiled code that is older than a change of the sources; returns whether it did.

    Where the installation is read-only nothing is done: numba keeps its cache elsewhere then.
    """
    digest, folders = sha256(), set()
    for source in sorted(package.rglob("*.py")):
        with suppress(OSError):
            text = source.read_bytes()
            if any(decorator in text for decorator in COMPILED):
                digest.update(text)
                folders.add(source.parent / "__pycache__")
    mark = package / "__pycache__" / MARK
    found = digest.hexdigest()
    with suppress(OSError):
        if mark.is_file() and mark.read_text() == found:
            return False
        for folder in folders:
            for pattern in CACHES:
                for file in folder.glob(pattern):
                    file.unlink(missing_ok=True)
        mark.parent.mkdir(exist_ok=True)
        mark.write_text(found)
        return True
    return False


@contextmanager
def announced(tell: Callable[[str], object]) -> Iterator[None]:
    """Tell of a compilation that takes long; nothing is said where the cache holds it all."""
    timer = threading.Timer(LONG, tell, (NOTICE,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
