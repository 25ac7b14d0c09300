# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""From two cameras' pictures to E/mu and to a cause: `PYTHONPATH=. python -m field.stereo`.

A seed draws a rope, the motion of two grippers, or of one and a free end, in three dimensions for
3 s, and two calibrated cameras. The independent rod is rendered, and the public tools do the rest:
`observe`, then `identify` from a guess of E that is up to 30 times off, or, with `--kind cause`,
`diagnose` on one recording of each motion, which hide one cause. The set-up is otherwise as the
parameter file states it; density and damping are guessed.
"""

import argparse
import json
import re
import tempfile
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from challenge.evaluate import compare
from challenge.manipulations import smooth_rows
from scipy.spatial.transform import Rotation

from dlo_ros.cli.main import main as dlo_ros
from dlo_ros.errors import SimulationError
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.synthesize import synthesize
from field.evaluate import OUTCOMES, judge, processor_time, share
from field.generate import Case

KINDS = ("grippers", "free", "cause")
DURATION = 3.0
EDGES, STEP = 100, 2e-3
"""Discretisation of the independent rod: 5e-5 of L off, a fifth of what the observer is."""
FAR_OFF = 30.0
"""Largest factor between the true E and its guess."""
BENDING = 2.5, 8.0
"""Range of L over the length (E D^2 / (16 mu g))^(1/3) along which bending carries the weight."""
CALLIPER = 1e-3
"""Stated relative standard deviation of the diameter, which is right: shapes tell E D^2/mu."""


@dataclass(frozen=True)
class Result:
    """The outcome of a case.

    Args:
        seen: share of the pairs of pictures in which the observer found the rope.
        off: ln(E/mu) found over the true one.
        std: its stated standard deviation; None where none is stated.
        seconds: processor time of each step [s].
        report: what `diagnose` wrote; None where it was not called.
    """

    case: Case
    seen: float
    off: float
    std: float | None
    seconds: dict[str, float]
    report: dict | None = None


def motion_of_grippers(rng: np.random.Generator) -> dict:
    """Both ends between two grippers, which move and turn in space; lengths over L."""
    span, down = rng.uniform(0.55, 0.8), rng.uniform(0.4, 0.8)
    start = _way(rng, [0.0, 0.0, 0.0, down, 0.0, 0.0], 0.06, turns=0.8)
    end = _way(rng, [span, 0.0, rng.uniform(-0.1, 0.1), -down, 0.0, 0.0], 0.12, turns=1.5)
    shape = [
        [0.0, 0.0, 0.0],
        [0.15, 0.02, -0.25],
        [span - 0.15, 0.05, -0.3],
        [span, 0.0, end[0][3]],
    ]
    return {"shape": shape, "ways": {"start": start, "end": end}}


def motion_of_one(rng: np.random.Generator) -> dict:
    """One end in a gripper that moves and turns in space, the other one free; lengths over L."""
    down = rng.uniform(0.2, 1.2)
    start = _way(rng, [0.0, 0.0, 0.0, down, 0.0, 0.0], 0.12, turns=0.8)
    s = np.linspace(0.0, 1.0, 5)
    angle = down + s * (1.5 - down)
    steps = np.diff(s, prepend=0.0)[:, None] * np.column_stack(
        [np.cos(angle), 0.1 * np.ones(5), -np.sin(angle)]
    )
    return {"shape": np.cumsum(steps, axis=0).tolist(), "ways": {"start": start}}


def _way(rng: np.random.Generator, first: list[float], far: float, turns: float) -> list:
    """Rows of time [s], x, y, z over L, angle, swing, turn [rad]: three stops after the first."""
    base, rows = np.array(first), [(0.1, *first)]
    size = np.array([far, far, far, 0.4, 0.4, turns])
    time = 0.1
    for _ in range(3):
        time += rng.uniform(0.5, 0.9)
        rows.append((time, *(base + size * rng.uniform(-1.0, 1.0, 6))))
    return smooth_rows(rows)


def cameras(rng: np.random.Generator, centre: np.ndarray, length: float) -> dict:
    """Two cameras that look at a point [m] from some three lengths away."""
    away = max(2.9 * length, 1.0) * rng.uniform(1.0, 1.15)
    base, high = rng.uniform(0.25, 0.35), rng.uniform(-0.15, 0.15)
    result = {}
    for name, side in (("left", -0.5), ("right", 0.5)):
        place = centre + np.array([side * base, -away, high + rng.uniform(-0.03, 0.03)])
        forward = (centre - place) / np.linalg.norm(centre - place)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        # Rows: the axes of the optical frame, x right, y down, z forward.
        pose = Rotation.from_matrix([right, np.cross(forward, right), forward])
        result[name] = {
            "width": 1280, "height": 720, "focal_length": [1500.0, 1500.0],
            "noise": float(rng.uniform(1.0, 4.0)), "blur": float(rng.uniform(0.4, 1.0)),
            "translation": (-pose.apply(place)).tolist(), "rotation": pose.as_quat().tolist(),
        }  # fmt: skip
    return result


def causes(rng: np.random.Generator, rod: dict, weight: float) -> dict[str, dict]:
    """Causes, one of which a case hides, each of a size that no tolerance holds.

    Args:
        rod: the true parameters.
        weight: weight of the rope per length [N/m].
    """
    length = rod["length"]
    mass = weight / 9.81 * length
    along, aside = rng.uniform(0.3, 0.7) * length, rng.uniform(-1.0, 1.0, 3)
    sign = float(rng.choice([-1.0, 1.0]))
    force = rng.uniform(0.15, 0.4) * weight * aside / np.linalg.norm(aside)
    turn = rng.uniform(0.15, 0.3) * aside / np.linalg.norm(aside)
    return {
        "point_mass": {"mass": float(rng.uniform(0.2, 0.6) * mass), "position": float(along)},
        "stiff_segment": {
            "centre": float(along), "extent": float(rng.uniform(0.15, 0.3) * length),
            "ratio": float(rng.uniform(3.0, 6.0)),
        },
        "intrinsic_curvature": {"curvature": float(sign * rng.uniform(1.5, 3.0) / length)},
        "quadratic_drag": {"coefficient": float(rng.uniform(1.0, 4.0) * mass / length**2)},
        "constant_force": {k: float(v) for k, v in zip("xyz", force, strict=True)},
        "clamp_angle": {"start": [float(v) for v in turn]},
        "command_delay": {"delay": float(rng.uniform(0.06, 0.1))},
    }  # fmt: skip


def draw(seed: int, kind: str) -> Case:
    """Draw a case; the same arguments give the same one.

    Args:
        kind: one of `KINDS`; the causes take turns from seed to seed.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 21])
    length, diameter = float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.004, 0.008))
    density = float(rng.uniform(1000.0, 3000.0))
    bending = length / np.exp(rng.uniform(*np.log(BENDING)))
    modulus = float(16.0 * density * 9.81 * bending**3 / diameter**2)
    rod = {"length": length, "diameter": diameter, "young_modulus": modulus, "density": density}
    rod["control_points"] = 10
    weight = density * np.pi / 4.0 * diameter**2 * 9.81
    drag = float(weight * rng.uniform(0.02, 0.1))
    damping = {"air_drag": drag, "relaxation_time": float(rng.uniform(0.002, 0.008))}
    factor = float(np.exp(0.5 * rng.normal()))
    off = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(FAR_OFF)))
    guess = {
        "rod": {
            "young_modulus": off * modulus,
            "density": factor * density,
            "diameter_std": CALLIPER * diameter,
        },
        "damping": {k: v * factor for k, v in damping.items()},
    }
    draws = causes(rng, rod, weight)
    name = list(draws)[seed % len(draws)]
    hidden = {name: draws[name]} if kind == "cause" else {}
    motions = {"grippers": motion_of_grippers, "free": motion_of_one}
    chosen = tuple(motions) if kind == "cause" else (kind,)
    trees = []
    # All recordings of a case share their cameras.
    middle = length * np.array([0.3, 0.0, -0.2 if kind == "grippers" else -0.42])
    views = cameras(rng, middle, length)
    for which in chosen:
        way = motions[which](rng)
        trees.append({
            "parameters": {"rod": rod, "damping": damping, "effects": hidden},
            "guess": guess, "duration": DURATION,
            "initial_shape": (length * np.array(way["shape"])).tolist(),
            "motion": {
                end: [
                    {"time": t, "position": [length * v for v in (x, y, z)], "angle": a,
                     "swing": b, "turn": c}
                    for t, x, y, z, a, b, c in rows
                ]
                for end, rows in way["ways"].items()
            },
            "camera": {"rate": 30.0}, "cameras": views,
            "look": {
                "rope_colour": [float(v) for v in rng.uniform(10.0, 90.0, 3)],
                "board_distance": 0.5,
            },
        })  # fmt: skip
    return Case(seed, hidden, {}, {}, chosen, tuple(trees))


def record(case: Case, folder: Path) -> list[Path]:
    """Render the recordings of a case; the bags."""
    bags = []
    for k, (name, tree) in enumerate(zip(case.manipulations, case.trees, strict=True)):
        made = read_experiment(tree, name, f"case {case.seed}")
        bags.append(folder / name)
        synthesize(made, bags[-1], seed=10 * case.seed + k, edges=EDGES, step=STEP)
    return bags


def tool(*words: object) -> str:
    """Printed output of a tool.

    Raises:
        SystemExit: it fails.
    """
    printed = StringIO()
    with redirect_stdout(printed):
        status = dlo_ros([str(w) for w in words])
    if status:
        raise SystemExit(f"{words[0]}: status {status}")
    return printed.getvalue()


def solve(case: Case, folder: Path) -> Result:
    """Record a case and let the tools work on it."""
    seconds, began = {}, processor_time()

    def step(name: str) -> None:
        nonlocal began
        now = processor_time()
        seconds[name], began = now - began, now

    bags = record(case, folder)
    step("synthesize")
    observed, seen = [], []
    for bag in bags:
        observed.append(folder / f"{bag.name}_observed")
        words = ("--params", bag / "params.yaml", "--output", observed[-1], bag)
        found, count = re.findall(r"(\d+) of (\d+)", tool("observe", *words))[0]
        seen.append(int(found) / int(count))
    step("observe")
    params, output = bags[0] / "params.yaml", folder / "result"
    name = "diagnose" if case.causes else "identify"
    tool(name, "--params", params, "--output", output, *observed)
    step(name)
    report = json.loads((output / "report.json").read_text()) if case.causes else None
    found = report["extended"] if report else json.loads((output / "estimate.json").read_text())
    rod, ratio = case.trees[0]["parameters"]["rod"], found["specific_modulus"]
    off = float(np.log(ratio["value"] / (rod["young_modulus"] / rod["density"])))
    std = ratio["std"] and ratio["std"] / ratio["value"]
    return Result(case, float(np.mean(seen)), off, std, seconds, report)


def line(r: Result) -> str:
    """A case in one line."""
    stated = "?" if r.std is None else f"{100.0 * r.std:.2f} %, {r.off / r.std:+.1f} std"
    spent = ", ".join(f"{k} {v:.0f} s" for k, v in r.seconds.items())
    text = f"E/mu {100.0 * r.off:+.2f} % (stated {stated}); seen {100.0 * r.seen:.0f} %; {spent}"
    if r.report is None:
        return text
    outcome, wrong = judge(r.case, r.report)
    (cause,) = r.case.causes
    named = " + ".join(" or ".join([e["name"], *e["rivals"]]) for e in r.report["effects"])
    missed, count, _ = compare(r.case.causes, r.report)
    found = share(r.report, r.report["noise_floor"])
    return (
        f"{cause} -> {r.report['verdict']}, {named or 'nothing'} ({outcome}; wrong: "
        f"{' + '.join(wrong) or 'none'}); share {'?' if found is None else f'{found:.2f}'}; "
        f"numbers missed {missed} of {count}; {text}"
    )


def summary(results: list[Result]) -> list[str]:
    """The numbers over all cases of one kind, as lines."""
    off = np.abs([r.off for r in results])
    stated = [abs(r.off) / r.std for r in results if r.std is not None]
    lines = [
        f"{len(results)} cases: E/mu off by {100.0 * np.median(off):.2f} % in the median, "
        f"{100.0 * off.max():.2f} % at most, within 2 % in {np.sum(off < 0.02)}, within 2 std in "
        f"{np.sum(np.array(stated) < 2.0)} of {len(stated)}"
    ]
    reports = [(r.case, r.report) for r in results if r.report]
    if reports:
        judged = [judge(case, report) for case, report in reports]
        lines.append(
            ", ".join(f"{w} {sum(o == w for o, _ in judged)}" for w in OUTCOMES)
            + f"; wrong names in {sum(bool(w) for _, w in judged)}"
        )
    for step in results[0].seconds:
        spent = [r.seconds[step] for r in results]
        lines.append(
            f"{step}: {np.median(spent):.0f} s of processor time, worst {max(spent):.0f} s"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="field.stereo", description=__doc__)
    parser.add_argument("--kind", choices=KINDS, action="append", default=[])
    parser.add_argument("--first", type=int, default=1, help="seed of the first case")
    parser.add_argument("--count", type=int, default=6, help="of cases of each kind")
    parser.add_argument("--keep", type=Path, help="folder in which the recordings are kept")
    arguments = parser.parse_args()
    for kind in arguments.kind or KINDS:
        results = []
        for seed in range(arguments.first, arguments.first + arguments.count):
            with tempfile.TemporaryDirectory() as folder:
                kept = arguments.keep and arguments.keep / f"{kind}_{seed}"
                try:
                    results.append(solve(draw(seed, kind), kept or Path(folder)))
                except SimulationError as err:
                    print(f"{kind} {seed}: no such motion: {err}", flush=True)
                    continue
            print(f"{kind} {seed}: {line(results[-1])}", flush=True)
        print("\n".join(summary(results)), flush=True)


if __name__ == "__main__":
    main()
