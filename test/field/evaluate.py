# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Let `diagnose` work on field cases and print what it named: `python -m field.evaluate`."""

import argparse
import json
import resource
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from challenge.draws import NAMED
from challenge.evaluate import compare

from dlo_ros.cli.main import main as dlo_ros
from dlo_ros.errors import SimulationError
from field import spatial
from field.generate import Case, draw

ALIKE = (
    {"gravity_tilt", "constant_force", "camera_rotation"},
    {"length_error", "camera_scale"},
    {"clamp_offset", "camera_shift"},
)
"""Errors of a set-up of which one does nearly what another does."""

DAMPINGS = {"air_drag": "air_drag", "internal_damping": "relaxation_time"}
"""Effects as which dampings are told that the parameter file only guesses, and their numbers."""

FORCES = ("air_drag", "constant_force")
"""Effects whose numbers have no standard deviation where nothing tells how large forces are."""

RATIOS = ("camera_scale", "twisting_stiffness")
"""Errors of a set-up whose numbers are factors."""

CURVES = ("intrinsic_curvature",)
"""Errors of a set-up whose numbers are values at as many places, evenly spaced along u."""

OUTCOMES = ("named", "rival", "told", "missed")
"""Possible outcomes for the main cause: one that does not matter beside an open set-up may stand in
the report's table, right and for certain, without being named."""


@dataclass(frozen=True)
class Result:
    """What came of a case.

    Args:
        main: one of `OUTCOMES`.
        tolerated: whether the main cause lies within what every set-up may have.
        wrong: names that stand for nothing that was hidden.
        share: fraction of the explainable ERR that is explained on held-out data.
        missed, parameters, beyond: how many numbers of the causes are beyond 10 % and 2 std, how
            many there are, and how many are beyond 2 std.
        modulus: ln(E / mu) off, over its stated standard deviation; None where none is stated.
        off: ln(E / mu) off.
    """

    seed: int
    hidden: tuple[str, ...]
    verdict: str
    named: tuple[str, ...]
    main: str
    tolerated: bool
    wrong: tuple[str, ...]
    share: float | None
    missed: int
    parameters: int
    beyond: int
    off: float
    modulus: float | None
    seconds: float


def judge(case: Case, report: dict) -> tuple[str, tuple[str, ...]]:
    """Whether the main cause was named, and what was named wrongly."""
    effects = report["effects"]
    rivals = {r for e in effects for r in e["rivals"]}
    named = {e["name"] for e in effects}
    main = next(iter(case.causes), None)
    outcome = "" if main is None else "missed"
    if main in named:
        outcome = "named"
    elif main in rivals:
        outcome = "rival"
    elif main is not None and is_told(main, _as_told(case, main, report), report["setup"]):
        outcome = "told"
    true = set(case.causes) | {n for n in case.set_up if _off(case, n) > 1.0}
    true |= {n for group in ALIKE if group & true for n in group}
    true |= {effect for effect, key in DAMPINGS.items() if _guess_off(case, key) > 1.0}
    wrong = tuple(e["name"] for e in effects if not ({e["name"]} | set(e["rivals"])) & true)
    return outcome, wrong


def _as_told(case: Case, name: str, report: dict) -> dict:
    """Numbers of a cause as the table of the set-up counts them.

    A damping counts from the guess. Nothing tells how large forces on a DLO are that was not
    weighed; they are told for the density of the extended model.
    """
    tree, guess = case.trees[0]["parameters"], case.trees[0]["guess"]
    numbers = dict(case.causes[name])
    weighed = "density_std" in guess["rod"] or name not in FORCES
    density = report["extended"]["density"]["value"] / tree["rod"]["density"]
    thicker = guess["rod"]["diameter"] / tree["rod"]["diameter"]
    scale = 1.0 if weighed else density * thicker**2
    key = DAMPINGS.get(name)
    before, after = (0.0, 0.0) if key is None else (tree["damping"][key], guess["damping"][key])
    return {k: scale * (before + np.asarray(x)) - after for k, x in numbers.items()}


def is_told(name: str, numbers: dict, setup: dict) -> bool:
    """Whether the table of the set-up holds all numbers of a cause right, the largest for certain.

    Right is within a tenth or two standard deviations, as for causes that are named.
    """
    certain = []
    for key, true in numbers.items():
        each = np.atleast_1d(true)
        full = f"{name}.{key}"
        several = sum(entry.startswith(f"{full}[") for entry in setup)
        if name in CURVES and several:  # given at other places than told
            each = np.interp(np.linspace(0.0, 1.0, several), np.linspace(0.0, 1.0, len(each)), each)
        names = [full] if len(each) == 1 and full in setup else [
            f"{full}[{k}]" for k in range(len(each))
        ]  # fmt: skip
        for entry, x in zip(names, each, strict=True):
            found = setup.get(entry)
            if found is None or not (found["std"] or name in FORCES):
                return False
            std = found["std"] or 0.0
            off, from_neutral = found["value"] - x, x - (1.0 if name in RATIOS else 0.0)
            if abs(off) > max(0.1 * abs(from_neutral), 2.0 * std):
                return False
            certain.append((abs(from_neutral), abs(from_neutral) >= 3.0 * std))
    return bool(certain) and max(certain)[1]


def is_tolerated(case: Case) -> bool:
    """Whether the main cause is an error that every set-up may have, within its tolerance.

    Then it is none that must be named: it stands in the table of the set-up.
    """
    if not case.causes:
        return False
    name, values = next(iter(case.causes.items()))
    if name in DAMPINGS:
        (added,) = values.values()
        return 0.0 < _guess_off(case, DAMPINGS[name], added) <= 1.0
    return name in _tolerances(case) and _off(case, name, values) <= 1.0


def _tolerances(case: Case) -> dict[str, float]:
    """Tolerances of the errors of a set-up."""
    length = case.trees[0]["parameters"]["rod"]["length"]
    degree = np.pi / 180.0
    return {
        "clamp_angle": 3.0 * degree, "clamp_offset": 5e-3 * length, "gravity_tilt": degree,
        "length_error": 5e-3 * length, "camera_scale": 5e-3, "camera_rotation": 0.5 * degree,
        "camera_shift": 5e-3 * length, "intrinsic_curvature": 0.5 / length,
        "stiffness_gradient": 0.3, "command_delay": 0.02, "twisting_stiffness": 0.7,
    }  # fmt: skip


def _off(case: Case, name: str, values: dict | None = None) -> float:
    """Largest number of a set-up's error in units of its tolerance.

    Args:
        values: its numbers; default: those of the case's set-up.
    """
    numbers = case.set_up[name] if values is None else values
    flat = np.concatenate([np.atleast_1d(v) for v in numbers.values()])
    off = np.log(flat) if name in RATIOS else flat
    return float(np.abs(off).max() / _tolerances(case)[name])


def _guess_off(case: Case, key: str, added: float = 0.0) -> float:
    """How far a guessed damping is too low, in units of its tolerance, a factor of three.

    Args:
        added: what a cause adds to the true one.
    """
    tree = case.trees[0]
    guess, true = tree["guess"]["damping"], tree["parameters"]["damping"]
    if f"{key}_std" in guess:
        return 0.0
    return float(np.log((true[key] + added) / guess[key]) / np.log(3.0))


def share(report: dict, floor: float) -> float | None:
    """Share of the explainable ERR that is explained, on held-out data."""
    before, after = report["baseline"]["err_holdout"], report["extended"]["err_holdout"]
    if before is None or after is None or before <= 1.2 * floor:
        return None
    return (before - max(after, floor)) / (before - floor)


def solve(case: Case, folder: Path, *, pictures: bool = False) -> Result:
    """Write a case and let the tool work on it."""
    bags, floor = case.write(folder, pictures=pictures)
    output = folder / "diagnosis"
    words = ["diagnose", "--params", folder / "params.yaml", "--output", output, *bags]
    began = processor_time()
    status = dlo_ros([str(w) for w in words])
    seconds = processor_time() - began
    if status:
        raise SystemExit(f"case {case.seed}: status {status}")
    report = json.loads((output / "report.json").read_text())
    simulated = json.loads((folder / "case.json").read_text())["compared"]
    simulated |= {n: _as_told(case, n, report) for n in DAMPINGS if n in case.causes}
    main, wrong = judge(case, report)
    rod = case.trees[0]["parameters"]["rod"]
    found = report["extended"]["specific_modulus"]
    off = float(np.log(found["value"] / (rod["young_modulus"] / rod["density"])))
    std = found["std"] and off / (found["std"] / found["value"])
    return Result(
        case.seed, tuple(case.causes), report["verdict"],
        tuple(e["name"] for e in report["effects"]), main, is_tolerated(case), wrong,
        share(report, floor or report["noise_floor"]), *compare(simulated, report), off, std,
        seconds,
    )  # fmt: skip


def processor_time() -> float:
    """Processor time of this process and those that it has waited for [s]."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, kinds))


def by_effect(results: list[Result], names: list[str]) -> list[str]:
    """A line for each effect that was asked for, over the cases in which it is the cause."""
    lines = []
    for name in names:
        mine = [r for r in results if r.hidden == (name,)]
        if not mine:
            lines.append(f"{name}: no case")
            continue
        told = ", ".join(f"{w} {sum(r.main == w for r in mine)}" for w in OUTCOMES)
        missed, total = sum(r.missed for r in mine), sum(r.parameters for r in mine)
        lines.append(
            f"{name}, {len(mine)} cases: {told}; wrong names in {sum(bool(r.wrong) for r in mine)};"
            f" numbers within 10 % or 2 std: {total - missed} of {total}; processor time: median "
            f"{np.median([r.seconds for r in mine]):.0f} s"
        )
    return lines


def summary(results: list[Result]) -> list[str]:
    """The numbers over all cases, as lines."""
    if not results:
        return ["no cases"]
    lines = []
    for count in sorted({len(r.hidden) for r in results}):
        mine = [r for r in results if len(r.hidden) == count]
        wrong = sum(bool(r.wrong) for r in mine)
        if count:
            told = ", ".join(f"{w} {sum(r.main == w for r in mine)}" for w in OUTCOMES)
        else:
            told = f"adequate {sum(r.verdict == 'adequate' for r in mine)}"
        lines.append(
            f"{count} causes, {len(mine)} cases: main cause {told}; wrong names in {wrong}"
        )
    caused = [r for r in results if r.hidden]
    for within, words in ((False, "beyond what every set-up may have"), (True, "within it")):
        told = [r.main for r in caused if r.tolerated is within]
        if told:
            counts = ", ".join(f"{w} {told.count(w)}" for w in OUTCOMES)
            lines.append(f"main causes {words}, {len(told)} cases: {counts}")
    shares = [r.share for r in results if r.share is not None]
    if shares:
        lines.append(f"explained of what could be, median: {np.median(shares):.2f}")
    missed, total = sum(r.missed for r in results), sum(r.parameters for r in results)
    beyond = sum(r.beyond for r in results)
    lines.append(
        f"numbers of causes within 10 % or 2 std: {total - missed} of {total}; within 2 std: "
        f"{total - beyond}"
    )
    stated = [abs(r.modulus) for r in results if r.modulus is not None]
    lines.append(
        f"E/mu within 2 std: {sum(m < 2.0 for m in stated)} of {len(stated)}; off by "
        f"{100.0 * np.median([abs(r.off) for r in results]):.1f} % in the median"
    )
    seconds = [r.seconds for r in results]
    lines.append(f"processor time: median {np.median(seconds):.0f} s, worst {max(seconds):.0f} s")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="field.evaluate", description=__doc__)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first")
    parser.add_argument("--count", type=int, default=20, help="of cases of each number of causes")
    parser.add_argument("--causes", type=int, action="append", choices=range(4), default=[])
    parser.add_argument(
        "--effect", action="append", choices=sorted({*NAMED, *spatial.CAUSES}), default=[],
        metavar="NAME", help="cases with this cause alone; may be repeated",
    )  # fmt: skip
    parser.add_argument("--space", action="store_true", help="motion and errors leave the plane")
    parser.add_argument("--pictures", action="store_true", help="render a camera's pictures")
    parser.add_argument("--keep", type=Path, help="folder in which the cases are kept")
    arguments = parser.parse_args()
    if arguments.space and arguments.pictures:
        parser.error("pictures are rendered of cases in the plane alone; leave --space out")
    absent = set(arguments.effect) - set(spatial.CAUSES if arguments.space else NAMED)
    if absent:
        parser.error(f"no cases are drawn with {', '.join(sorted(absent))} there")
    if arguments.effect and arguments.causes:
        parser.error("--effect asks for cases with one cause; leave --causes out")
    kinds: list[tuple[str, int, tuple[str, ...]]] = (
        [(name, 1, (name,)) for name in arguments.effect]
        or [(str(count), count, ()) for count in arguments.causes or range(4)]
    )  # fmt: skip
    results: list[Result] = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        for label, count, names in kinds:
            try:
                case = (spatial.draw if arguments.space else draw)(
                    seed, count, names, own_rope=True
                )
            except RuntimeError as err:
                print(f"{seed}_{label}: {err}", flush=True)
                continue
            with tempfile.TemporaryDirectory() as folder:
                kept = arguments.keep and arguments.keep / f"{seed}_{label}"
                try:
                    r = solve(case, kept or Path(folder), pictures=arguments.pictures)
                except SimulationError as err:
                    print(f"{seed}_{label}: no such recording: {err}", flush=True)
                    continue
            results.append(r)
            print(f"{seed}_{label}: {_line(r)}", flush=True)
    print("\n".join([*by_effect(results, arguments.effect), *summary(results)]))


def _line(r: Result) -> str:
    share = "?" if r.share is None else f"{r.share:.2f}"
    told = "?" if r.modulus is None else f"{r.modulus:.1f} std"
    return (
        f"{' + '.join(r.hidden) or 'nothing'} -> {r.verdict}, {' + '.join(r.named) or 'nothing'} "
        f"({r.main}; wrong: {' + '.join(r.wrong) or 'none'}); share {share}; numbers missed "
        f"{r.missed} of {r.parameters}; E/mu {100.0 * r.off:+.1f} % ({told}); {r.seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
