# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`identify --params FILE --output DIR [--validate BAG] BAG ...`: estimates E and mu."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dlo_ros.cli.identify_results import report, summary, tree
from dlo_ros.cli.loading import (
    add_model_arguments,
    load_all,
    load_settings,
    prepare,
    unstated,
)
from dlo_ros.cli.progress import progress_bar, steps
from dlo_ros.cli.results import add_results_folder, check_results_folder, with_std, written
from dlo_ros.effects import quantities
from dlo_ros.effects.measurement.length_error import LengthError
from dlo_ros.effects.physics.clamp_angle import ClampAngle
from dlo_ros.effects.physics.gravity_tilt import GravityTilt
from dlo_ros.effects.registry import STD
from dlo_ros.errors import InputError
from dlo_ros.files import write_text
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.offline.posterior_sampling import Sample, bootstrap, sample
from dlo_ros.identification.offline.recording_identification import Identification, identify
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.inference.parallel import Pool, open_pool
from dlo_ros.parameters import EFFECTS_PREFIX, Settings
from dlo_ros.report import write_identification_report
from dlo_ros.spline import FloatArray

TOLERANCES = (
    ("--clamp-angle-std", "RAD", "the clamps' directions are known", ClampAngle),
    ("--tilt-std", "RAD", "the board's or the camera's level is known", GravityTilt),
    ("--length-std", "M", "the DLO's length is known", LengthError),
)
"""Options, their units, words for them, and the effect whose tolerances they are."""
DONE_SO_FAR = ".identify.part.json"


def _destination(option: str) -> str:
    """Name of an option's value among the parsed arguments."""
    return option.removeprefix("--").replace("-", "_")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="recordings to fit")
    add_model_arguments(parser)
    add_results_folder(parser)
    parser.add_argument(
        "--validate",
        type=Path,
        action="append",
        default=[],
        metavar="BAG",
        help="recording that is only predicted; may be repeated",
    )
    for option, unit, words, effect in TOLERANCES:
        parser.add_argument(
            option, type=float, metavar=unit, dest=_destination(option),
            help=f"std to which {words}; 0: exactly; default: effects.{effect.name}.*_std",
        )  # fmt: skip
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes to simulate in; default: threads"
    )
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster that simulates, tcp://host:8786"
    )
    parser.add_argument(
        "--sample", type=int, default=0, metavar="N", help="draw N samples of the posterior, too"
    )
    parser.add_argument(
        "--bootstrap",
        type=int,
        default=0,
        metavar="N",
        help="fit N random choices of the recordings, too",
    )


def run(arguments: argparse.Namespace) -> int:
    """Identify; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    settings = load_settings(arguments, [*arguments.bags, *arguments.validate])
    output: Path = arguments.output
    check_results_folder(output)
    for name in ("sample", "bootstrap"):
        if getattr(arguments, name) < 0:
            raise InputError(f"--{name} is {getattr(arguments, name)}; it must not be negative")
    if arguments.bootstrap == 1:
        raise InputError("--bootstrap is 1; a spread takes at least two draws")
    settings = _with_tolerances(settings, arguments)
    if arguments.bootstrap and len(arguments.bags) < 2:
        raise InputError("--bootstrap draws recordings and needs at least two of them")
    with open_pool(arguments.workers, arguments.scheduler) as pool:
        train, validate = load_all(arguments, arguments.bags, arguments.validate, settings)
        prepare()
        with progress_bar() as bar:
            task = bar.add_task("Identifying", total=1.0)
            progress = steps(bar, task)
            found = identify(train, settings, validate, progress=progress, pool=pool)
            sampled, redrawn = _more(arguments, train, settings, found, pool, progress)
    with written(output):
        shown = [*train, *validate]
        write_results(output, settings, found, shown, sampled, redrawn, unstated(arguments))
    for line in summary(found):
        print(line)
    print(f"written to {output}: estimate.json, estimate.yaml, report.html")
    return 0


def _with_tolerances(settings: Settings, arguments: argparse.Namespace) -> Settings:
    """The settings with the tolerances of the command line.

    Raises:
        InputError: one of them is negative, or no number.
    """
    values = settings.flat()
    for option, _, _, effect in TOLERANCES:
        std = getattr(arguments, _destination(option))
        if std is None:
            continue
        if not (np.isfinite(std) and std >= 0.0):
            raise InputError(f"{option} is {std:g}; it must be zero or positive")
        values |= {
            f"{EFFECTS_PREFIX}{effect.name}.{key}{STD}": std for key in quantities(effect.name)
        }
    return Settings.from_mapping(values)


def _more(
    arguments: argparse.Namespace, train: Sequence[Manipulation], settings: Settings,
    found: Identification, pool: Pool, progress: Any,
) -> tuple[Sample | None, FloatArray | None]:  # fmt: skip
    """Samples of the posterior and fits to drawn recordings, where they are asked for."""
    sampled, redrawn = None, None
    start = searchable(settings).with_effects(found.estimate.settings.effects)
    if arguments.sample:
        sampled = sample(
            start, found.fitted, found.forces, count=arguments.sample, pool=pool,
            done=lambda share: progress("sampling", share),
        )  # fmt: skip
    if arguments.bootstrap:
        kept = _Kept(arguments.output / DONE_SO_FAR, _key(train, settings))

        def done(number: int, theta: FloatArray | None) -> None:
            kept.add(number, theta)
            progress("drawing recordings", len(kept.results) / arguments.bootstrap)

        redrawn = bootstrap(
            found.fitted, count=arguments.bootstrap, pool=pool,
            before=kept.results.copy(), done=done,
        )  # fmt: skip
        kept.remove()
    return sampled, redrawn


def _key(train: Sequence[Manipulation], settings: Settings) -> str:
    """Tells whether results belong to the same recordings and settings."""
    digest = hashlib.sha256(settings.text().encode())
    for part in _content(tuple(train)):
        digest.update(part)
    return digest.hexdigest()


def _content(value: object) -> Iterator[bytes]:
    """All that dataclasses, tuples and arrays in one another hold, in order."""
    if isinstance(value, tuple):
        for one in value:
            yield from _content(one)
    elif is_dataclass(value):
        for each in fields(value):
            yield from _content(getattr(value, each.name))
    else:
        yield value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()


class _Kept:
    """Results of a long run, kept in a file so that a run cut short goes on where it was.

    Args:
        path: path of the file.
        key: key of the run; results of another run do not count.
    """

    def __init__(self, path: Path, key: str) -> None:
        self._path, self._key = path, key
        self.results: dict[int, FloatArray] = {}
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
            before = json.loads(path.read_text())
            results = before["results"]
            if before["key"] == key and before["digest"] == _digest(results):
                self.results = {int(k): np.array(v) for k, v in results.items()}

    def add(self, number: int, theta: FloatArray | None) -> None:
        """Keep a result."""
        if theta is None:
            return
        self.results[number] = theta
        self._path.parent.mkdir(parents=True, exist_ok=True)
        results = {str(k): [float(x) for x in v] for k, v in self.results.items()}
        tree = {"key": self._key, "digest": _digest(results), "results": results}
        write_text(self._path, json.dumps(tree))

    def remove(self) -> None:
        """The run is complete."""
        self._path.unlink(missing_ok=True)


def _digest(results: Any) -> str:
    """Tells whether kept results are those that were written."""
    return hashlib.sha256(json.dumps(results, sort_keys=True).encode()).hexdigest()


def write_results(
    output: Path,
    settings: Settings,
    found: Identification,
    recordings: Sequence[Manipulation],
    sampled: Sample | None = None,
    redrawn: FloatArray | None = None,
    without: Collection[str] = (),
) -> None:
    """Write estimate.json, estimate.yaml and report.html into a folder.

    Args:
        output: the folder, made where it is missing.
        settings: the initial guess.
        found: the result, recordings in the order given here.
        recordings: the recordings that the estimate comes from.
        sampled, redrawn: see `tree`.
        without: names of parameters that estimate.yaml shall not state.
    """
    output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(tree(found, sampled, redrawn), indent=2, allow_nan=False)
    write_text(output / "estimate.json", text + "\n")
    comment = "Estimated by dlo_ros identify; nodes and tools load this file as it is."
    made = with_std(found.estimate.settings, found.estimate.specific_modulus_std)
    write_text(output / "estimate.yaml", made.text(comment, without))
    shown = report(settings, found, recordings)
    write_identification_report(output / "report.html", shown)
