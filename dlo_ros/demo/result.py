# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The outputs of a live run: estimate.json, the last line and the report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlo_ros.demo.outcome import LiveOutcome
from dlo_ros.errors import InputError
from dlo_ros.files import write_text
from dlo_ros.nodes.received_data import (
    DENSITY,
    QUANTITIES,
    SPECIFIC_MODULUS,
    UNITS,
    YOUNG_MODULUS,
    EstimateSample,
    ReceivedData,
)
from dlo_ros.report import (
    EstimateRow,
    IdentificationReport,
    ParameterTrack,
    Photograph,
    RecordingRow,
    ShapeFrame,
)
from dlo_ros.spline import FloatArray

NAMES: Mapping[str, str] = {
    YOUNG_MODULUS: "Young's modulus E",
    DENSITY: "density mu",
    SPECIFIC_MODULUS: "E/mu",
}


EXPLANATION = (
    "ERR at first is the time mean over the recording that the initial guess gives, simulated "
    "afterwards; ERR at the end is the mean of the live one over the last half second.",
)
TOO_BUSY = (
    "ERR at the end is not known: this machine was too busy for the nodes, and the simulator did "
    "not have the estimate in time. Run it again with nothing else beside it."
)


def read_truth(bag: Path) -> dict[str, float]:
    """True values by the names in `QUANTITIES`; empty where the recording has none beside it.

    Raises:
        InputError: truth.yaml is there and has no usable E and mu.
    """
    path = bag / "truth.yaml"
    if not path.is_file():
        return {}
    try:
        tree = yaml.safe_load(path.read_text())  # long, and written by `synthesize`
        rod = tree.get("/**", {}).get("ros__parameters", tree)["rod"]
        truth = {name: float(rod[name]) for name in (YOUNG_MODULUS, DENSITY)}
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as err:
        raise InputError(
            f"{path}: rod.young_modulus and rod.density cannot be read from it ({err})"
        ) from err
    return truth | {SPECIFIC_MODULUS: truth[YOUNG_MODULUS] / truth[DENSITY]}


def estimate_tree(
    received: ReceivedData, outcome: LiveOutcome, bag: str, truth: Mapping[str, float]
) -> Any:
    """Content of estimate.json: the keys of `identify`, and `true` where the truth is known."""
    sample = outcome.sample
    tree: dict[str, Any] = {
        name: {"value": sample.values[name], "std": _finite(sample.std[name])}
        for name in QUANTITIES
    }
    tree["identifiable"] = {name: received.identifiable(name) for name in QUANTITIES}
    tree["noise_floor"] = outcome.noise_floor
    tree["recordings"] = [
        {"bag": bag, "role": "train", "err": outcome.err, "err_initial": outcome.err_initial}
    ]
    if truth:
        tree["true"] = {name: {"value": truth[name], "std": 0.0} for name in QUANTITIES}
    return tree


def write_json(path: Path, tree: Any) -> None:
    """Write JSON so that a reader sees the old file or the whole new one."""
    write_text(path, json.dumps(tree, indent=2, allow_nan=False) + "\n")


def last_line(outcome: LiveOutcome, truth: Mapping[str, float]) -> str:
    """The result in one line, such as `ERR 31.2 -> 1.4 mm; E/mu 1.98e+04 +- 0.03e+04 m^2/s^2`."""
    before, after = (
        "unknown" if err is None else f"{1e3 * err:.1f}"
        for err in (outcome.err_initial, outcome.err)
    )  # fmt: skip
    text = f"ERR {before} -> {after} mm; E/mu {with_std(outcome.sample, SPECIFIC_MODULUS)}"
    return f"{text} (true {truth[SPECIFIC_MODULUS]:.2e})" if truth else text


def remarks(received: ReceivedData, outcome: LiveOutcome) -> list[str]:
    """Sentences on a run in which the nodes did not keep up with the recording."""
    result = []
    if received.passes > 1:
        result.append(
            f"This machine was too busy for the nodes, so the recording was played "
            f"{received.passes} times; this is the last time."
        )
    if received.waiting:
        result.append(
            f"The estimate is not that of the whole recording: {received.waiting} observed shapes "
            "were still waiting for the estimator when the demo ended."
        )
    if outcome.err is None:
        result.append(TOO_BUSY)
    return result


def with_std(sample: EstimateSample, name: str) -> str:
    """A quantity with its standard deviation, both with one power of ten, and its unit."""
    value, std = sample.values[name], sample.std[name]
    exponent = math.floor(math.log10(abs(value))) if value else 0
    if math.isfinite(std):
        # As many places as make the standard deviation visible, two at least.
        small = exponent - math.floor(math.log10(std)) if std > 0.0 else 2
        places = min(max(small, 2), 5)
        shown = f"{std / 10.0**exponent:.{places}f}e{exponent:+03d}"
    else:
        places, shown = 2, "unknown"
    return f"{value:.{places}e} +- {shown} {UNITS[name]}"


def report(
    received: ReceivedData,
    outcome: LiveOutcome,
    bag: str,
    length: float,
    truth: Mapping[str, float],
    photographs: Mapping[int, Photograph],
    remarks: Sequence[str],
    cameras: Mapping[str, FloatArray],
) -> IdentificationReport:
    """The report of a live run.

    Args:
        received: everything that was heard.
        outcome: the estimate, ERR before and after.
        bag: name of the recording.
        length: length of the DLO [m].
        truth: true values from `read_truth`.
        photographs: pictures by the stamp of the observed spline.
        remarks: sentences for the reader.
        cameras: positions [m] of the cameras that have names.
    """
    start = min(received.observed)
    sample = outcome.sample
    estimates = [
        EstimateRow(
            NAMES[name],
            UNITS[name],
            sample.values[name],
            _finite(sample.std[name]),
            truth.get(name),
            received.identifiable(name),
        )
        for name in QUANTITIES
    ]
    recording = RecordingRow(
        bag,
        "live",
        length,
        outcome.err_initial,
        outcome.err,
        _frames(received, outcome, length, start, photographs),
    )
    return IdentificationReport(
        title=f"Live identification of {bag}",
        headline=last_line(outcome, truth),
        estimates=tuple(estimates),
        recordings=(recording,),
        tracks=tuple(_track(received.samples, name, start, truth.get(name)) for name in QUANTITIES),
        noise_floor=outcome.noise_floor,
        remarks=(*EXPLANATION, *remarks),
        cameras=cameras,
    )


def _frames(
    received: ReceivedData,
    outcome: LiveOutcome,
    length: float,
    start: int,
    photographs: Mapping[int, Photograph],
) -> tuple[ShapeFrame, ...]:
    errors = received.errors(length)
    return tuple(
        ShapeFrame(
            time=(stamp - start) / 1e9,
            observed=received.observed[stamp],
            predicted=received.predicted_at(stamp),
            initial=outcome.initial.get(stamp),
            err=errors.get(stamp),
            photograph=photographs.get(stamp),
        )
        for stamp in sorted(received.observed)
    )


def _track(
    samples: Sequence[EstimateSample], name: str, start: int, true: float | None
) -> ParameterTrack:
    return ParameterTrack(
        NAMES[name],
        UNITS[name],
        np.array([(s.stamp - start) / 1e9 for s in samples]),
        np.array([s.values[name] for s in samples]),
        np.array([s.std[name] for s in samples]),
        true,
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
