# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`synthesize EXPERIMENT.yaml --output BAG`: records a simulated experiment of known truth."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import track

from dlo_ros.compilation import compile_first
from dlo_ros.errors import InputError
from dlo_ros.synthesis.experiment import find_experiment, load_experiment, with_wrench


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "experiment",
        metavar="EXPERIMENT",
        help="experiment file (YAML), or the name of a bundled one such as c_shape",
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="BAG", help="folder of the bag to write"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of noise and texture (default 0)"
    )
    parser.add_argument(
        "--no-images",
        action="store_true",
        help="write observed splines with measurement noise instead of camera images",
    )
    parser.add_argument(
        "--wrench",
        action="store_true",
        help="write forces and torques at the grips, too, where the experiment has no block "
        "`wrench`: with noise of 1 %% and an offset of 5 %% of the weight",
    )
    parser.add_argument("--force", action="store_true", help="replace an existing bag")


def run(arguments: argparse.Namespace) -> int:
    """Write the recording; returns the exit status.

    Raises:
        DloError: the experiment or the output is unusable.
    """
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}; it must not be negative")
    experiment = load_experiment(find_experiment(arguments.experiment))
    if arguments.wrench and experiment.wrench is None:
        experiment = with_wrench(experiment)
    console = Console(stderr=True)
    # Here, so that bad input is answered before anything is compiled.
    compile_first(("synthesis",), console.print)
    from dlo_ros.synthesis.synthesize import synthesize

    images = not arguments.no_images

    def progress(frames: Iterable[int], count: int) -> Iterable[int]:
        if not console.is_terminal:
            return frames  # else it would print an empty line
        what = "Rendering" if images else "Measuring"
        return track(frames, what, total=count, console=console, transient=True)

    truth = synthesize(
        experiment,
        arguments.output,
        seed=arguments.seed,
        images=images,
        force=arguments.force,
        progress=progress,
    )
    rod = experiment.truth.rod
    kind = "images" if images else "observed splines"
    print(
        f"{arguments.output}: {len(truth.stamps)} {kind} of '{experiment.name}', true "
        f"E {rod.young_modulus:.3g} Pa, density {rod.density:g} kg/m^3, "
        f"E/mu {rod.specific_modulus:.3g} m^2/s^2"
    )
    return 0
