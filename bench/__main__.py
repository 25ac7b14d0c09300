# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Compare the rod with its goals and with other simulators: `python -m bench`."""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from bench.contender import Choice, Contender, cpu_time, search
from bench.mujoco_chain import MujocoChain
from bench.mujoco_flex import MujocoFlex
from bench.ours import Ours
from bench.report import Row, number, show, write
from bench.sets import SETS, ForSets, OursForSets
from bench.single import SIZES, Statics, cost_of_parameters, cost_of_sizes
from bench.tasks import TASKS, Task
from bench.vision import vision_rows

BLOCK = 0.02  # [s] CPU time that one measurement of a short run fills
STATIC_GOAL = 200.0  # [us]
PARAMETER_GOAL = 0.2  # of a forward run
ELASTICA_GOAL = 1.0 / 200.0
SET_GOALS = {0.01: 1.0 / 5.0, 0.001: 1.0 / 8.0}
# Largest ratio to the best MuJoCo by error and task.
GOALS = {
    ("T1", 0.001): 1.0 / 1.5, ("T2", 0.001): 1.0 / 2.0, ("T4", 0.001): 1.0 / 10.0,
    ("T1", 0.01): 2.0, ("T2", 0.01): 1.0, ("T3", 0.01): 2.0, ("T4", 0.01): 1.0,
}  # fmt: skip

OURS, SPACE = Ours(spatial=False), Ours(spatial=True)
CHAIN, FLEX, ELASTICA = MujocoChain(), MujocoFlex(), "PyElastica"
# Not held against a goal, only shown: joints that know no third dimension, steps beyond 40 ms.
SHOWN = (MujocoChain("hinge"), MujocoChain(long_steps=True))
FORMS = ((OURS, ""), (SPACE, ", with twist"))
FOR_SETS = (OursForSets(OURS), OursForSets(SPACE), ForSets(CHAIN))

Key = tuple[str, str, float]  # contender, task, level


def main(arguments: Sequence[str] | None = None) -> None:
    """Search settings, measure in interleaved rounds, write and show the result."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds (default 5)")
    parser.add_argument("--output", type=Path, default=Path("build/bench.json"))
    parser.add_argument("--tasks", nargs="+", choices=[t.name for t in TASKS], default=None)
    parser.add_argument("--without-pyelastica", action="store_true", help="leave out the slowest")
    options = parser.parse_args(arguments)
    console = Console()
    if not console.is_terminal:
        console.width = 150
    tasks = [t for t in TASKS if options.tasks is None or t.name in options.tasks]
    contenders: list[Contender] = [OURS, SPACE, CHAIN, FLEX, *SHOWN]
    packages = ["mujoco", "numba", "numpy"]
    if not options.without_pyelastica:
        from bench.pyelastica import PyElastica  # which need not be installed otherwise

        contenders.append(PyElastica())
        packages.append("pyelastica")

    choices: dict[Key, Choice] = {}
    for task in tasks:
        for contender in track(contenders, f"{task.name}: settings", console=console):
            for level, choice in search(contender, task).items():
                choices[contender.name, task.name, level] = choice
    show_settings(console, "one set", choices)
    for_sets: dict[Key, Choice] = {}
    for task in tasks:
        if task.moving:
            continue
        for searcher in track(FOR_SETS, f"{task.name}: settings for {SETS} sets", console=console):
            for level, choice in search(searcher, task).items():
                for_sets[searcher.name, task.name, level] = choice
    show_settings(console, f"{SETS} sets", for_sets)

    measures: dict[Any, Callable[[], float]] = {}
    errors: dict[str, float] = {}
    for key, choice in choices.items():
        measures[key] = timing(choice)
    for choice in for_sets.values():
        add_sets(choice, measures, errors)
    statics = {form: Statics(spatial=form is SPACE) for form, _ in FORMS}
    for form, _ in FORMS:
        measures["static", form.name] = lambda s=statics[form]: 1e6 * cpu_time(s.public, BLOCK)
        compiled = statics[form].compiled()
        measures["static compiled", form.name] = lambda c=compiled: 1e6 * cpu_time(c, BLOCK)
    series: dict[str, list[dict[int, float]]] = {}
    samples: dict[Any, list[float]] = {key: [] for key in measures}
    for measure in measures.values():
        measure()  # warm
    for form, _ in FORMS:
        cost_of_parameters(spatial=form is SPACE)
    for _ in track(range(options.rounds), "rounds", console=console):
        for key, measure in measures.items():
            samples[key].append(measure())
        for form, _ in FORMS:
            spatial = form is SPACE
            series.setdefault(f"sizes {form.name}", []).append(cost_of_sizes(spatial=spatial))
            series.setdefault(f"parameters {form.name}", []).append(
                cost_of_parameters(spatial=spatial)
            )
    value = {key: median(found) for key, found in samples.items()}
    curves = {
        name: {n: median(r[n] for r in rounds) for n in rounds[0]}
        for name, rounds in series.items()
    }

    rows = [*task_rows(tasks, value), *set_rows(tasks, value), *single_rows(value, curves)]
    rows += vision_rows(options.rounds)
    details = {
        "machine": platform.machine(), "python": platform.python_version(),
        "versions": {p: version(p) for p in packages},
        "load": os.getloadavg(), "rounds": options.rounds,
        "choices": [
            {"contender": n, "task": t, "level": level, "error": c.error,
             "setting": dict(c.setting), "ms_per_s": value[n, t, level],
             "rounds": samples[n, t, level]}
            for (n, t, level), c in choices.items()
        ],
        "sets": [
            {"contender": n, "task": t, "level": level, "setting": dict(c.setting),
             "worst_error": errors[f"{n} {t} {level}"],
             "rounds": samples.get(("64 sets", n, t, level))}
            for (n, t, level), c in for_sets.items()
        ],
        "curves": curves,
        "static_us": {" ".join(k): v for k, v in value.items() if k[0].startswith("static")},
        "gradient_error": statics[OURS].gradient_error(),
    }  # fmt: skip
    write(options.output, rows, details)
    show_costs(console, choices, value)
    show_curves(console, curves)
    console.print(
        "static equilibrium and gradient, compiled part alone: "
        + ", ".join(f"{value['static compiled', f.name]:.0f} us{t}" for f, t in FORMS)
    )
    for name, worst in errors.items():
        level = float(name.split()[-1])
        if worst > level:
            console.print(f"{SETS} sets, {name}: not counted, one of them has {worst:.2e}")
    show(console, rows)
    missed = sum(row.met is False for row in rows)
    console.print(f"{len(rows)} goals, {missed} missed; written to {options.output}")


def timing(choice: Choice) -> Callable[[], float]:
    """Measures a chosen setting once: ms of CPU per simulated second."""
    run = choice.contender.prepare(choice.task, choice.setting).run
    if choice.contender.name != ELASTICA:
        run()
    duration = choice.task.duration
    return lambda: 1e3 * cpu_time(run, BLOCK) / duration


def add_sets(choice: Choice, measures: dict[Any, Any], errors: dict[str, float]) -> None:
    """Measurement of 64 parameter sets at a setting found for them: ms of CPU a set."""
    task, level = choice.task, choice.level
    assert isinstance(choice.contender, ForSets)
    together = choice.contender.together(task, choice.setting)
    worst = together.worst_error()
    key = ("64 sets", choice.contender.name, task.name, level)
    errors[" ".join(map(str, key[1:]))] = worst
    if worst > level:
        return  # good enough in the search, not among all: it does not count
    measures[key] = lambda: 1e3 * cpu_time(together.run, BLOCK) / task.duration / SETS


def task_rows(tasks: Sequence[Task], value: dict[Any, float]) -> list[Row]:
    """Ours against MuJoCo and PyElastica, in every task at every error."""
    rows = []
    for against_mujoco in (True, False):
        for task in tasks:
            for level in task.levels:
                peers = (CHAIN.name, FLEX.name) if against_mujoco else (ELASTICA,)
                costs = {p: value[p, task.name, level] for p in peers
                         if (p, task.name, level) in value}  # fmt: skip
                peer = min(costs, key=costs.__getitem__) if costs else peers[0]
                goal = GOALS[task.name, level] if against_mujoco else ELASTICA_GOAL
                rows += [
                    Row(
                        f"{task.name} at {100 * level:g} %{twist}",
                        value.get((form.name, task.name, level)), "ms/s", peer, costs.get(peer),
                        goal,
                    )
                    for form, twist in FORMS
                ]  # fmt: skip
    return rows


def set_rows(tasks: Sequence[Task], value: dict[Any, float]) -> list[Row]:
    """64 parameter sets at once."""
    rows = []
    for task in tasks:
        for level in () if task.moving else task.levels:
            peer = value.get(("64 sets", CHAIN.name, task.name, level))
            rows += [
                Row(
                    f"{SETS} sets of {task.name} at {100 * level:g} %{twist}",
                    value.get(("64 sets", form.name, task.name, level)), "ms/s a set",
                    "mujoco.batch" if peer else "mujoco.batch: no setting is good enough", peer,
                    SET_GOALS[level],
                )
                for form, twist in FORMS
            ]  # fmt: skip
    return rows


def single_rows(value: dict[Any, float], curves: dict[str, dict[int, float]]) -> list[Row]:
    """Absolute goals."""
    rows = []
    for form, twist in FORMS:
        rows.append(Row(
            f"static equilibrium, warm, gradient of 4, n = 10{twist}",
            value["static", form.name], "us", "goal", STATIC_GOAL, 1.0,
        ))  # fmt: skip
        sizes = curves[f"sizes {form.name}"]
        first, last = SIZES[0], SIZES[-1]
        rows.append(Row(
            f"step at {last} over {first} control points{twist}",
            sizes[last] / sizes[first], "times", "linear", last / first, 1.0,
        ))  # fmt: skip
        carried = curves[f"parameters {form.name}"]
        most = max(carried)
        rows.append(Row(
            f"the first parameter in a dynamic run{twist}",
            carried[1] - 1.0, "of a run", "goal", PARAMETER_GOAL, 1.0,
        ))  # fmt: skip
        rows.append(Row(
            f"each of {most - 1} further parameters in a dynamic run{twist}",
            (carried[most] - carried[1]) / (most - 1), "of a run", "goal", PARAMETER_GOAL, 1.0,
        ))  # fmt: skip
    return rows


def show_settings(console: Console, what: str, choices: dict[Key, Choice]) -> None:
    """Print the chosen settings with their errors."""
    table = Table(title=f"Cheapest settings that reach the error, {what}")
    for name in ("task", "error / L", "simulator", "has", "setting"):
        table.add_column(name)
    for (name, task, level), choice in sorted(choices.items(), key=lambda c: (c[0][1], -c[0][2])):
        setting = {k: float(f"{v:.3g}") if isinstance(v, float) else v
                   for k, v in choice.setting.items()}  # fmt: skip
        text = json.dumps(setting).strip("{}").replace('"', "")
        table.add_row(task, f"{level:g}", name, f"{choice.error:.1e}", text)
    console.print(table)


def show_costs(console: Console, choices: dict[Key, Choice], value: dict[Any, float]) -> None:
    """All costs, those without a goal as well."""
    columns = sorted({key[1:] for key in choices}, key=lambda c: (c[0], -c[1]))
    table = Table(title="ms of CPU per simulated second")
    table.add_column("simulator")
    for task, level in columns:
        table.add_column(f"{task} {100 * level:g} %", justify="right")
    for name in dict.fromkeys(key[0] for key in choices):
        table.add_row(name, *(number(value.get((name, *column))) for column in columns))
    console.print(table)


def show_curves(console: Console, curves: dict[str, dict[int, float]]) -> None:
    """Cost over the number of control points, and over the number of parameters."""
    for name, curve in curves.items():
        unit = "us a step" if name.startswith("sizes") else "of a run without"
        console.print(f"{name} ({unit}): " + ", ".join(f"{n}: {v:.3g}" for n, v in curve.items()))


if __name__ == "__main__":
    main()
