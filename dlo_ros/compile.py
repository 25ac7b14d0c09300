"""Compile all numerical kernels once, so that nodes and tools start without a pause.

`python -m dlo_ros.compile` runs the rod model and two frames of a simulated experiment through the
observer; numba keeps what it compiled beside the sources.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

from dlo_ros.command import Motion
from dlo_ros.recordings import iterate_images
from dlo_ros.rod.compile import compile_kernels
from dlo_ros.synthesis.experiment import find_experiment, load_experiment
from dlo_ros.synthesis.synthesize import synthesize
from dlo_ros.vision.camera import Camera
from dlo_ros.vision.observer import Observer

EXPERIMENT = "c_shape"
FRAMES = 2  # the first is searched as a whole, the second followed


def compile_all() -> None:
    """Run everything that numba compiles."""
    compile_kernels()
    experiment = load_experiment(find_experiment(EXPERIMENT))
    short = replace(experiment, duration=(FRAMES - 0.5) / experiment.camera.rate)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / EXPERIMENT
        synthesize(short, bag)
        observer: Observer | None = None
        for stamp, picture, info in iterate_images(bag):
            if observer is None:
                size = info.width, info.height
                pose = short.truth.camera
                camera = Camera.from_info(info.k, info.d, info.distortion_model, *size, pose)
                observer = Observer(short.truth, camera, Motion([short.command]))
            observer.observe(stamp, picture)


if __name__ == "__main__":
    began = time.perf_counter()
    print("compiling rod, vision and synthesis (once; the result is cached) ...", flush=True)
    compile_all()
    print(f"done in {time.perf_counter() - began:.1f} s")
