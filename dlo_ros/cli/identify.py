"""`identify --params FILE --output DIR [--validate BAG] BAG ...`: estimates E and mu."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from dlo_ros.cli.loading import add_model_arguments, load_manipulation, load_settings, prepare
from dlo_ros.errors import InputError
from dlo_ros.identification.estimate import Estimate
from dlo_ros.identification.forecast import Manipulation
from dlo_ros.identification.offline import Identification, identify
from dlo_ros.parameters import Settings
from dlo_ros.report import (
    Estimate as ReportedEstimate,
)
from dlo_ros.report import (
    IdentificationReport,
    RecordingResult,
    ShapeFrame,
    write_identification_report,
)

QUANTITIES = (
    ("young_modulus", "Young's modulus E", "Pa"),
    ("density", "density mu", "kg/m^3"),
    ("specific_modulus", "E/mu", "m^2/s^2"),
)
WORDS = {
    "young_modulus": "E",
    "density": "mu",
    "air_drag": "air drag",
    "relaxation_time": "relaxation time",
}
MOST_FRAMES = 60  # of a recording in the report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="recordings to fit")
    add_model_arguments(parser)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="DIR", help="folder for the results"
    )
    parser.add_argument(
        "--validate",
        type=Path,
        action="append",
        default=[],
        metavar="BAG",
        help="recording that is only predicted; may be repeated",
    )


def run(arguments: argparse.Namespace) -> int:
    """Identify; returns the exit status.

    Raises:
        DloError: an input or the output is unusable.
    """
    settings = load_settings(arguments)
    output: Path = arguments.output
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file; give a folder for the results")
    train = [load_manipulation(bag, settings) for bag in arguments.bags]
    validate = [load_manipulation(bag, settings) for bag in arguments.validate]
    prepare()
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("Identifying", total=1.0)

        def progress(text: str, share: float) -> None:
            bar.update(task, description=text.capitalize(), completed=share)

        found = identify(train, settings, validate, progress=progress)
    try:
        write_results(output, settings, found, [*train, *validate])
    except OSError as err:
        raise InputError(f"{output}: cannot be written ({err.strerror})") from err
    for line in summary(found):
        print(line)
    print(f"written to {output}: estimate.json, estimate.yaml, report.html")
    return 0


def write_results(
    output: Path, settings: Settings, found: Identification, recordings: Sequence[Manipulation]
) -> None:
    """Write estimate.json, estimate.yaml and report.html into a folder.

    Args:
        output: the folder, made where it is missing.
        settings: the initial guess.
        found: the result, recordings in the order given here.
        recordings: what was measured.
    """
    output.mkdir(parents=True, exist_ok=True)
    _replace(output / "estimate.json", json.dumps(tree(found), indent=2, allow_nan=False) + "\n")
    comment = "Estimated by dlo_ros identify; nodes and tools load this file as it is."
    _replace(output / "estimate.yaml", found.estimate.settings.text(comment))
    write_identification_report(output / "report.html", _report(settings, found, recordings))


def tree(found: Identification) -> dict[str, Any]:
    """What estimate.json holds (interface.md)."""
    estimate = found.estimate
    result: dict[str, Any] = {
        name: {"value": getattr(estimate, name), "std": getattr(estimate, f"{name}_std")}
        for name, _, _ in QUANTITIES
    }
    result["identifiable"] = dict(estimate.identifiable)
    result["noise_floor"] = found.noise_floor
    result["recordings"] = [
        {"bag": r.name, "role": r.role, "err": r.err, "err_initial": r.err_initial}
        for r in found.recordings
    ]
    return result


def summary(found: Identification) -> list[str]:
    """The result for the terminal."""
    lines = []
    for name, words, unit in QUANTITIES:
        value, std = getattr(found.estimate, name), getattr(found.estimate, f"{name}_std")
        spread = "+- unknown" if std is None else f"+- {std:.2g}"
        known = ""
        if not found.estimate.identifiable[name]:
            prior = found.estimate.settings.rod.density_std > 0.0
            known = " (with density_std)" if prior else " (not determined by the recordings)"
        lines.append(f"{words}: {value:.4g} {spread} {unit}{known}")
    for r in found.recordings:
        before = "unknown" if r.err_initial is None else f"{1e3 * r.err_initial:.2f} mm"
        after = "unknown" if r.err is None else f"{1e3 * r.err:.2f} mm"
        lines.append(f"ERR of {r.name} ({r.role}): {before} -> {after}")
    return lines


def remarks(estimate: Estimate, found: Identification) -> list[str]:
    """Sentences on what the recordings can and cannot tell."""
    sentences = []
    if estimate.identifiable["specific_modulus"] and not estimate.identifiable["density"]:
        sentences.append(
            "The shapes determine E/mu only: E and mu change together without changing any shape. "
            "To know them apart, weigh the DLO and give density_std, hang a known mass on it, or "
            "give the air drag with its standard deviation."
        )
    if not estimate.identifiable["specific_modulus"]:
        sentences.append(
            "These recordings do not determine E/mu to 25 %. A shape in which stiffness competes "
            "with weight tells more, such as a free end of about twice (B/w)^(1/3)."
        )
    for a, b in estimate.traded:
        sentences.append(f"{WORDS[a]} and {WORDS[b]} are traded against each other by these data.")
    if not found.converged:
        sentences.append("The fit has not converged; the numbers are where it stopped.")
    errors = [
        r.forecast.resolution_error * estimate.settings.rod.length
        for r in found.recordings
        if r.forecast is not None and r.forecast.resolution_error > 0.0
    ]
    if errors:
        sentences.append(f"The simulation's own error is {1e3 * max(errors):.2g} mm at most.")
    return sentences


def _report(
    settings: Settings, found: Identification, recordings: Sequence[Manipulation]
) -> IdentificationReport:
    estimate = found.estimate
    length = settings.rod.length
    return IdentificationReport(
        title="Identification from recordings",
        headline=summary(found)[2],
        estimates=tuple(
            ReportedEstimate(
                words,
                unit,
                getattr(estimate, name),
                getattr(estimate, f"{name}_std"),
                identifiable=estimate.identifiable[name],
            )
            for name, words, unit in QUANTITIES
        ),
        recordings=tuple(
            RecordingResult(r.name, r.role, length, r.err_initial, r.err, _frames(r, measured))
            for r, measured in zip(found.recordings, recordings, strict=True)
        ),
        noise_floor=found.noise_floor,
        remarks=tuple(remarks(estimate, found)),
    )


def _frames(result: Any, measured: Manipulation) -> tuple[ShapeFrame, ...]:
    if result.forecast is None:
        return ()
    observed = {o.stamp: o.control_points for o in measured.observations}
    stamps = result.forecast.stamps
    every = max(1, len(stamps) // MOST_FRAMES)
    return tuple(
        ShapeFrame(
            (int(stamps[k]) - int(stamps[0])) * 1e-9,
            observed[int(stamps[k])],
            result.forecast.predicted[k],
            err=float(result.forecast.err[k]),
        )
        for k in range(0, len(stamps), every)
    )


def _replace(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text)
    temporary.replace(path)
