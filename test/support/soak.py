# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Two hours of simulated time at the highest rate that the machine holds.

    python test/support/soak.py --hours 2 --minutes 30 --output build/soak.csv

The live simulator and identifier follow a motion that begins again every twenty seconds, on a clock
that runs faster than the wall's: faster still while both keep up, slower where they do not. Each
pass their resident memory, the lag of the predictions and the queue of the estimator are noted.
The first fifth warms up; then memory may grow by five per cent, and nothing else.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import conftest  # noqa: F401  (a graph of its own that stays on this machine)
from fault_rig import NANOSECONDS, Command, N, Rig, shapes

SECONDS = 20.0
FLAT = 0.05
WAITING = 20
"""Splines that may wait for the estimator at the end of a pass, less than a second of them."""

COLUMNS = (
    "wall_s", "simulated_s", "rate", "simulator_mb", "identifier_mb", "lag_s", "waiting", "dropped",
    "specific_modulus",
)  # fmt: skip


def wave() -> Command:
    """The start turned up and down with growing, then falling amplitude; at rest at both ends."""
    times = np.arange(0.0, SECONDS + 0.01, 0.05)
    envelope = np.where(times < 14.0, np.sin(math.pi * times / 14.0) ** 2, 0.0)
    angle = 0.4 * envelope * np.sin(2.0 * math.pi * 0.9 * times)
    rotations = np.zeros((len(times), 1, 4))
    rotations[:, 0, 1], rotations[:, 0, 3] = np.sin(angle / 2.0), np.cos(angle / 2.0)
    nothing = np.full((len(times), 1, 3), np.nan)
    return Command(0, ("start",), times, np.zeros((len(times), 1, 3)), rotations, nothing, N)


def memory(rig: Rig, name: str) -> float:
    """Resident memory of a node [MB]."""
    pid = rig.nodes[name].process.pid
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


def soak(rig: Rig, hours: float, minutes: float) -> list[dict[str, float]]:
    """Play until so many hours are simulated or so many minutes have passed."""
    motion = wave()
    measured = shapes(SECONDS, motion)
    began, rows = time.monotonic(), []
    simulated = 0.0
    while simulated < 3600.0 * hours and time.monotonic() - began < 60.0 * minutes:
        rig.predicted.clear()
        del rig.statuses[:-50]
        rig.drive(SECONDS, measured=measured, imposed=motion)
        simulated += SECONDS
        values = rig.values("identifier")
        row = {
            "wall_s": time.monotonic() - began,
            "simulated_s": simulated,
            "rate": rig.rate,
            "simulator_mb": memory(rig, "simulator"),
            "identifier_mb": memory(rig, "identifier"),
            "lag_s": rig.lag(SECONDS) if rig.predicted else math.inf,
            "waiting": float(values.get("splines waiting for the estimator", 0)),
            "dropped": float(values.get("splines dropped", 0)),
            "specific_modulus": float(values.get("specific_modulus [m^2/s^2]", "nan")),
        }
        rows.append(row)
        print("  ".join(f"{name} {row[name]:.4g}" for name in COLUMNS), flush=True)
        rig.base += round(SECONDS * NANOSECONDS)
        keeps_up = row["lag_s"] < 0.2 * rig.rate and row["waiting"] < WAITING
        rig.rate = min(rig.rate * 1.15, 50.0) if keeps_up else max(rig.rate * 0.8, 1.0)
    return rows


def verdict(rows: list[dict[str, float]]) -> list[str]:
    """What has grown between the first and the last quarter after warming up; empty: nothing."""
    steady = rows[len(rows) // 5 :]
    quarter = max(len(steady) // 4, 1)
    wrong = []

    def median(name: str, part: list[dict[str, float]]) -> float:
        return float(np.median([row[name] for row in part]))

    for name in COLUMNS[3:8]:
        early, late = median(name, steady[:quarter]), median(name, steady[-quarter:])
        print(f"{name}: {early:.4g} -> {late:.4g}")
        if name.endswith("_mb") and late > (1.0 + FLAT) * early:
            wrong.append(f"{name} grows by {100 * (late / early - 1):.1f} %")
        if name == "lag_s" and late > early + 0.5:
            wrong.append("predictions fall behind")
        if name == "waiting" and late > early + WAITING:
            wrong.append("the estimator's queue grows")
    return wrong


def main() -> int:
    """Run it; exit status 1 where something grows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--hours", type=float, default=2.0, help="of simulated time")
    parser.add_argument("--minutes", type=float, default=120.0, help="of wall time at most")
    parser.add_argument("--output", type=Path, help="table of the passes, CSV")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder))
        try:
            rows = soak(rig, arguments.hours, arguments.minutes)
        finally:
            rig.close()
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        with arguments.output.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
    wrong = verdict(rows)
    print("; ".join(wrong) or "nothing grows")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
