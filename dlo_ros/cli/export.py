# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""`export --params FILE --format FORMAT --output FILE`: the cable for another simulator.

With `--recording BAG` it is the recording that is written, as tables.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dlo_ros import __version__
from dlo_ros.cli.export_recording import TABLES, write_recordings
from dlo_ros.cli.loading import load_manipulation, prepare
from dlo_ros.dependencies import extra
from dlo_ros.errors import InputError, SimulationError
from dlo_ros.export import mujoco_run
from dlo_ros.export.chain import CableChain
from dlo_ros.export.draws import ParameterKnowledge, described, draw, read_knowledge, statement
from dlo_ros.export.fidelity import (
    DEFAULT_ELEMENTS,
    Choice,
    Fidelity,
    another_chain,
    choose,
    first_chain,
    longest_step,
    step_of_another,
)
from dlo_ros.export.format_support import unsupported
from dlo_ros.export.formats import FORMATS, Format
from dlo_ros.export.grips import pinned
from dlo_ros.export.scenes import ComparedMotion, recorded_scene, standard_scene
from dlo_ros.files import write_text
from dlo_ros.inference.forecast import Manipulation
from dlo_ros.parameters import Settings

MAX_ERR = 0.01  # of the length, that the other simulator may be off by default
MOST_SAMPLES = 100_000
MOST_IMPOSSIBLE = 100  # cables drawn in turn: where so many are, hardly any is possible
REFERENCE_FINENESS = 10.0  # times finer than the allowed error is the rod against which is held


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the tool."""
    parser.add_argument(
        "--params", type=Path, required=True, metavar="FILE", help="parameter file of the DLO"
    )
    parser.add_argument(
        "--format", choices=(*FORMATS, *TABLES), required=True,
        help="; ".join(f"{name}: {f.title}" for name, f in FORMATS.items())
        + f"; with --recording {', '.join(TABLES)}",
    )  # fmt: skip
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="file to write")
    parser.add_argument(
        "--max-err", type=float, default=MAX_ERR, metavar="SHARE",
        help="how far the other simulator may be from the rod, static and moving, of the length; "
        "default: %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "--bag", type=Path, metavar="BAG",
        help="recording whose grips and motion are taken, and with which the file is compared, too",
    )  # fmt: skip
    parser.add_argument(
        "--sample", type=int, metavar="N",
        help="write N plausible cables as well, numbered, for domain randomisation",
    )  # fmt: skip
    parser.add_argument(
        "--estimate", type=Path, metavar="FILE",
        help="estimate.json of identify: how well E/mu and the other numbers are known",
    )  # fmt: skip
    parser.add_argument(
        "--recording", type=Path, action="append", metavar="BAG",
        help="write this recording instead of the cable, into the folder of --output: csv, or "
        "parquet in LeRobot's layout, where each --recording is an episode",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Export; returns the exit status.

    Raises:
        DloError: an input or the output is unusable, or the DLO cannot be simulated.
    """
    if arguments.recording or arguments.format in TABLES:
        return write_recordings(arguments)
    form, output = FORMATS[arguments.format], arguments.output
    _check(arguments)
    full = Settings.load(arguments.params)
    known = read_knowledge(full, arguments.estimate)
    left_out = unsupported(full, form.supported)
    fine = _finer(left_out.settings, arguments.max_err)
    manipulation = load_manipulation(arguments.bag, full) if arguments.bag else None
    prepare()
    scenes = _scenes(manipulation, fine, full)
    mujoco = mujoco_run.installed()
    notes, choice = _chosen(mujoco, form, scenes, fine, arguments.max_err)
    chain = first_chain(scenes[0], fine, choice.elements)
    lines = [
        *notes,
        *form.approximations(chain),
        *left_out.lines,
        *(f"{name} is left out: only the ends are held" for name in pinned(scenes[0].command)),
    ]
    names = [output, *_numbered(output, arguments.sample or 0)]
    drawn = _plausible(scenes[0], fine, known, choice.elements)
    cables = itertools.chain([(fine, chain)], drawn)
    for number, (name, (cable, links)) in enumerate(zip(names, cables, strict=False)):
        used = replace(
            choice, step=step_of_another(links, choice.step, chain) if number else choice.step
        )
        head = _head(arguments.params, form, cable, number, statement(full, known), used, lines)
        write_text(name, form.write(links, step=used.step, comment=head))
    _tell(output, form, choice, statement(full, known), lines, names)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    if not (math.isfinite(arguments.max_err) and 0.0 < arguments.max_err < 1.0):
        raise InputError(f"--max-err is {arguments.max_err:g}; it must be between 0 and 1")
    if arguments.sample is not None and not 0 < arguments.sample <= MOST_SAMPLES:
        raise InputError(f"--sample is {arguments.sample}; it must be 1 to {MOST_SAMPLES}")
    if arguments.output.is_dir():
        raise InputError(f"{arguments.output}: is a folder; give the name of a file")
    if not arguments.output.absolute().parent.is_dir():
        raise InputError(f"{arguments.output}: its folder does not exist; make it first")


def _finer(settings: Settings, max_err: float) -> Settings:
    """Settings whose simulation is finer than the error that is asked for."""
    simulation = settings.simulation
    tolerance = min(simulation.tolerance, max_err / REFERENCE_FINENESS)
    return replace(settings, simulation=replace(simulation, tolerance=tolerance))


def _scenes(
    manipulation: Manipulation | None, settings: Settings, full: Settings
) -> list[ComparedMotion]:
    """The recording's motion where there is one, and the standard one unless that says it all."""
    if manipulation is None:
        return [standard_scene(settings)]
    scene = recorded_scene(manipulation, settings, full)
    return [scene] if scene.moves and scene.settled else [scene, standard_scene(settings)]


def _chosen(
    mujoco: Any | None,
    form: Format,
    scenes: Sequence[ComparedMotion],
    settings: Settings,
    max_err: float,
) -> tuple[list[str], Choice]:
    """The resolution, and a sentence on how it was found."""
    default = Choice(
        DEFAULT_ELEMENTS, longest_step(first_chain(scenes[0], settings, DEFAULT_ELEMENTS))
    )
    if mujoco is None:
        return [
            f"nothing was run: MuJoCo is not installed ({extra('export')}), "
            f"so it has {DEFAULT_ELEMENTS} elements"
        ], default
    notes = []
    if form.plugin and not mujoco_run.has_plugin(mujoco, form.plugin):
        return [
            f"nothing was run: MuJoCo {mujoco.__version__} has no {form.plugin} (3.17 is the last "
            f"that has it; mjcf-chain needs none), so it has {DEFAULT_ELEMENTS} elements"
        ], default
    if not form.run:
        notes.append(
            f"{form.simulator} was not run: the same chain in MuJoCo {mujoco.__version__} stands "
            "for it"
        )
    found = choose(mujoco, scenes, settings, plugin=bool(form.plugin), max_err=max_err)
    if found is None:
        raise SimulationError("MuJoCo's cable blows up with every time step that was tried")
    if found.worst > max_err:
        notes.append(
            f"WARNING: {100 * max_err:g} % of the length is not reached; this is the best that "
            "was tried"
        )
    return notes, found


def _plausible(
    scene: ComparedMotion, settings: Settings, known: ParameterKnowledge, elements: int
) -> Iterator[tuple[Settings, CableChain]]:
    """Plausible cables without end, each in its own shape; impossible ones are drawn again.

    Impossible is a place beyond the DLO's end, or a DLO too short for its two grips.
    """
    impossible = 0
    for cable in draw(settings, known):
        try:
            chain = another_chain(scene, cable, elements)
        except (InputError, SimulationError) as err:
            impossible += 1
            if impossible == MOST_IMPOSSIBLE:
                raise InputError(
                    f"--sample: {impossible} cables in turn that were drawn are impossible, the "
                    f"last one since {err}; state smaller standard deviations"
                ) from err
            continue
        impossible = 0
        yield cable, chain


def _numbered(output: Path, count: int) -> list[Path]:
    """Names of the plausible cables."""
    width = max(len(str(count)), 3)
    return [
        output.with_name(f"{output.stem}_{k:0{width}d}{output.suffix}") for k in range(1, count + 1)
    ]


def _head(
    params: Path, form: Format, cable: Settings, number: int, known: str, choice: Choice,
    lines: Sequence[str],
) -> str:  # fmt: skip
    """The head of a file, as text without comment marks."""
    which = f"Plausible cable {number}, drawn around {params}" if number else f"Cable of {params}"
    result = [
        f"{which}, exported by dlo_ros {__version__} as {form.title}.",
        f"Use: {form.use}",
        *described(cable),
        known,
        _resolution(choice),
        *(_fidelity(f) for f in choice.achieved),
        *lines,
    ]
    return "\n".join(result)


def _resolution(choice: Choice) -> str:
    return f"{choice.elements} elements, time step {choice.step:g} s"


def _fidelity(found: Fidelity) -> str:
    """The errors of a scene, as a line."""
    parts = []
    if math.isfinite(found.static):
        parts.append(f"at rest {100 * found.static:.2g} %")
    if math.isfinite(found.largest):
        parts.append(
            f"moving {100 * found.mean:.2g} % in the mean, {100 * found.largest:.2g} % at most"
        )
    text = f"ERR against the rod of dlo_ros, of the length ({found.scene}): {'; '.join(parts)}"
    if math.isfinite(found.seconds):
        text += f"; MuJoCo takes {1e3 * found.seconds:.3g} ms for a second"
    if math.isfinite(found.recorded):
        text += (
            f"; ERR against the recording {1e3 * found.recorded:.2f} mm, of the rod "
            f"{1e3 * found.rod_recorded:.2f} mm"
        )
    return text


def _tell(
    output: Path, form: Format, choice: Choice, known: str, lines: Sequence[str],
    names: Sequence[Path],
) -> None:  # fmt: skip
    print(f"{output}: {form.title}, {_resolution(choice)}")
    for found in choice.achieved:
        print(_fidelity(found))
    print(known)
    for line in lines:
        print(line)
    if len(names) > 1:
        print(f"{len(names) - 1} plausible cables: {names[1]} to {names[-1].name}")
    print(f"use: {form.use.replace('FILE', repr(str(output)))}")
