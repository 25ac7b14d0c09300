# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Let `diagnose` solve challenges and print what it named: `python -m challenge.evaluate`."""

import argparse
import json
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median

from challenge.draws import NAMED, SET_UP
from challenge.generate import KINDS, Challenge, draw
from dlo_ros.cli.main import main as dlo_ros
from dlo_ros.errors import SimulationError

OUTCOMES = ("named", "among rivals", "part", "unexplained", "adequate", "wrong", "failed")


@dataclass(frozen=True)
class Case:
    """One challenge and what came of it.

    Args:
        kind, hidden: kind of the challenge and names of its hidden effects.
        outcome: outcome, one of `OUTCOMES`.
        named: causes that the tool named.
        seconds: run time of the tool [s].
        gain: err on held-out data over the noise floor, where something was named.
        missed: effect parameters that are neither within 10 % nor within 2 std of the truth.
        parameters: effect parameters that could be compared.
        beyond: how many of them are more than 2 std off.
    """

    kind: str
    hidden: tuple[str, ...]
    outcome: str
    named: tuple[str, ...]
    seconds: float
    gain: float | None
    missed: int
    parameters: int
    beyond: int


def judge(hidden: set[str], report: dict) -> str:
    """What a report is worth where `hidden` (names of the interface) is to be found."""
    effects = report["effects"]
    if not effects:  # what is certain though small is named with an adequate model, too
        return "adequate" if report["verdict"] == "adequate" else "unexplained"
    # Each named effect stands for itself or for one of its rivals.
    named = {e["name"] for e in effects}
    right = [e for e in effects if ({e["name"]} | set(e["rivals"])) & hidden]
    if len(right) < len(effects):
        return "wrong"
    if named == hidden:
        return "named"
    covered = hidden & named.union(*(set(e["rivals"]) for e in effects))
    return "among rivals" if covered == hidden else "part"


def good(case: Case) -> bool:
    """Whether an outcome is what one hopes for; of three effects, two named and none wrong."""
    outcome = case.outcome
    found = outcome in ("named", "among rivals")
    return {
        "none": outcome == "adequate",
        "foreign": outcome == "unexplained",
        "weak": found or outcome == "unexplained",
        "triple": found or (outcome == "part" and len({*case.named} & {*case.hidden}) >= 2),
    }.get(case.kind, found)


def compare(hidden: dict[str, dict], report: dict) -> tuple[int, int, int]:
    """Effect parameters that were missed, that could be compared, and that are beyond a stated
    2 std.
    """
    missed = count = beyond = 0
    for e in report["effects"]:
        for key, true in hidden.get(e["name"], {}).items():
            found = e["parameters"].get(key)
            if found is None or isinstance(true, list) or isinstance(found["value"], list):
                continue
            count += 1
            off = abs(found["value"] - true)
            stated = 2.0 * (found["std"] or 0.0)
            missed += off > max(0.1 * abs(true), stated)
            beyond += bool(found["std"]) and off > stated
    return missed, count, beyond


def solve(challenge: Challenge, folder: Path) -> Case:
    """Write a challenge and let the tool work on it."""
    kind = challenge.kind
    bags = challenge.write(folder)
    hidden = challenge.effects | challenge.foreign
    output = folder / "diagnosis"
    words = ["diagnose", "--params", folder / "params.yaml", "--output", output, *bags]
    began = time.monotonic()
    status = dlo_ros([str(w) for w in words])
    seconds = time.monotonic() - began
    if status:
        return Case(kind, tuple(hidden), "failed", (), seconds, None, 0, 0, 0)
    return case_of(challenge, json.loads((output / "report.json").read_text()), seconds)


def case_of(challenge: Challenge, report: dict, seconds: float) -> Case:
    """A challenge and its outcome, by the tool's report."""
    hidden = challenge.effects | challenge.foreign
    named = tuple(e["name"] for e in report["effects"])
    after, floor = report["extended"]["err_holdout"], report["noise_floor"]
    gain = after / floor if named and after and floor else None
    outcome = judge(set(challenge.effects), report)
    missed = compare(hidden, report)
    return Case(challenge.kind, tuple(hidden), outcome, named, seconds, gain, *missed)


def by_effect(cases: list[Case], names: list[str]) -> list[str]:
    """A line for each effect that was asked for, over the cases in which it is hidden."""
    lines = []
    for name in names:
        mine = [c for c in cases if c.hidden == (name,)]
        if not mine:
            lines.append(f"{name}: no case")
            continue
        counts = Counter(c.outcome for c in mine)
        told = ", ".join(f"{o} {counts[o]}" for o in OUTCOMES if counts[o])
        missed, total = sum(c.missed for c in mine), sum(c.parameters for c in mine)
        lines.append(
            f"{name}, {len(mine)} cases: {told}; parameters within 10 % or 2 std: "
            f"{total - missed} of {total}; median {median(c.seconds for c in mine):.0f} s"
        )
    return lines


def summary(cases: list[Case]) -> list[str]:
    """The confusion matrix and the other numbers, as lines."""
    if not cases:
        return ["no cases"]
    width = max(len(o) for o in OUTCOMES) + 2
    lines = [" " * 10 + "".join(f"{o:>{width}}" for o in OUTCOMES) + f"{'good':>8}"]
    for kind in dict.fromkeys(c.kind for c in cases):
        mine = [c for c in cases if c.kind == kind]
        counts = Counter(c.outcome for c in mine)
        share = sum(map(good, mine)) / len(mine)
        row = "".join(f"{counts[o]:>{width}}" for o in OUTCOMES)
        lines.append(f"{kind:<10}{row}{share:>8.0%}")
    lines += [
        f"{c.kind}: {' + '.join(c.hidden) or 'nothing'} -> {c.outcome}: {' + '.join(c.named)}"
        for c in cases
        if not good(c)
    ]
    gains = [c.gain for c in cases if c.gain is not None]
    if gains:
        near = sum(g < 1.3 for g in gains)
        lines.append(f"ERR within 1.3 times the noise floor: {near} of {len(gains)}")
    missed, count = sum(c.missed for c in cases), sum(c.parameters for c in cases)
    if count:
        beyond = sum(c.beyond for c in cases)
        lines.append(
            f"parameters within 10 % or 2 std: {count - missed} of {count}; within 2 std: "
            f"{count - beyond}"
        )
    lines.append(f"longest: {max(c.seconds for c in cases):.0f} s")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="challenge.evaluate", description=__doc__)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first of each kind")
    parser.add_argument("--count", type=int, default=20, help="of each kind")
    parser.add_argument("--kind", action="append", choices=KINDS, default=[])
    parser.add_argument(
        "--effect", action="append", choices=sorted({*NAMED, *SET_UP}), default=[],
        metavar="NAME", help="hide this effect, of kind `single` unless --kind says another one; "
        "may be repeated",
    )  # fmt: skip
    arguments = parser.parse_args()
    names: list[tuple[str, ...]] = [(name,) for name in arguments.effect] or [()]
    kinds = arguments.kind or (["single"] if arguments.effect else list(KINDS))
    cases: list[Case] = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        for kind, hidden in product(kinds, names):
            try:
                challenge = draw(seed, kind, hidden)
            except RuntimeError as err:
                print(f"{seed} {kind}: {err}", flush=True)
                continue
            with tempfile.TemporaryDirectory() as folder:
                try:
                    c = solve(challenge, Path(folder))
                except SimulationError as err:
                    print(f"{seed} {kind}: no such recording: {err}", flush=True)
                    continue
            cases.append(c)
            told = f"{c.hidden} -> {c.outcome} {c.named} {c.seconds:.0f} s"
            print(f"{seed} {kind}: {told}", flush=True)
    print("\n".join([*by_effect(cases, arguments.effect), *summary(cases)]))


if __name__ == "__main__":
    main()
