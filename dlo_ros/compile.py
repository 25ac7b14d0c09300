# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compile all numerical kernels once, so that nodes and tools start without a pause.

`python -m dlo_ros.compile` runs each stage on something small; numba keeps what it compiled beside
the sources.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import dlo_ros.rod.compile
import dlo_ros.vision.compile
from dlo_ros.synthesis.experiment import find_experiment, load_experiment
from dlo_ros.synthesis.synthesize import synthesize


def compile_synthesis() -> None:
    """Simulate and render one frame of an experiment."""
    experiment = replace(load_experiment(find_experiment("c_shape")), duration=0.01)
    with tempfile.TemporaryDirectory() as folder:
        synthesize(experiment, Path(folder) / "bag")


STAGES: dict[str, Callable[[], object]] = {
    "rod": dlo_ros.rod.compile.compile_kernels,
    "vision": dlo_ros.vision.compile.compile_kernels,
    "synthesis": compile_synthesis,
}


if __name__ == "__main__":
    print("Compiling numerical kernels (once; the result is cached)", flush=True)
    for name, work in STAGES.items():
        began = time.perf_counter()
        work()
        print(f"  {name}: {time.perf_counter() - began:.1f} s", flush=True)
