# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Writes the recording of a simulated experiment: a bag, and beside it the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from dlo_ros.command import NANOSECONDS
from dlo_ros.errors import InputError
from dlo_ros.observation import CentrelinePoints
from dlo_ros.recordings import topics
from dlo_ros.recordings.message_building import (
    BAG_MESSAGES,
    command_message,
    points_message,
    spline_message,
)
from dlo_ros.recordings.wrenches import write_wrenches
from dlo_ros.recordings.write import BagWriter
from dlo_ros.spline import FloatArray, SplineBasis
from dlo_ros.synthesis.experiment import Experiment
from dlo_ros.synthesis.gripper_frames import write_frames
from dlo_ros.synthesis.picture_bag import (
    record_board_pictures,
    record_pictures,
    warn_out_of_sight,
)
from dlo_ros.synthesis.render import Renderer
from dlo_ros.synthesis.rod_reactions import record
from dlo_ros.synthesis.true_motion import Truth, build_simulation, simulate

POSE = ("translation", "rotation")  # of the board in a camera
LEAD = NANOSECONDS // 100
"""How long before its stamp the command is logged [ns], so that it is played first."""

FrameProgress = Callable[[Iterable[int], int], Iterable[int]]
"""Wraps the loop over the frames, given how many there are; rich.progress.track does."""


def synthesize(
    experiment: Experiment,
    output: Path,
    *,
    seed: int = 0,
    images: bool = True,
    force: bool = False,
    progress: FrameProgress = lambda frames, _: frames,
    edges: int | None = None,
    step: float | None = None,
) -> Truth:
    """Simulate an experiment and record it.

    Args:
        experiment: the experiment: its rope, its motion, its cameras.
        output: folder of the bag.
        seed: seed of noise and texture; the same seed gives the same bag.
        images: whether a camera is rendered; otherwise the observed splines are written directly.
        force: whether an existing bag is replaced.
        progress: wraps the loop over the frames.
        edges: number of edges of the simulated rope; default as in `true_motion.build_simulation`.
        step: time step of its simulation [s]; likewise.

    Returns:
        The true motion.

    Raises:
        RecordingError: the bag cannot be written.
        SimulationError: the rope cannot be simulated.
        InputError: images of a camera that moves, or of a rope behind the board.
    """
    if images and "camera_creep" in experiment.hidden:
        raise InputError(
            f"{experiment.name}: no images can be made by a camera that creeps; use --no-images"
        )
    with BagWriter(output, force) as writer:
        simulation, grips = build_simulation(experiment, edges=edges, step=step)
        length, frame = experiment.truth.rod.length, experiment.truth.frame_id
        if experiment.wrench is None:
            truth = simulate(simulation, experiment.stamps, length)
        else:
            truth, wrenches = record(experiment.wrench, simulation, experiment.stamps, length, seed)
            for one in wrenches:
                write_wrenches(writer, frame, one)
        if experiment.truth.command.source != "topic":
            write_frames(writer, experiment.truth, experiment.command, experiment.stamps[-1])
        else:
            command = command_message(BAG_MESSAGES, experiment.command)
            writer.write(topics.COMMAND, command, experiment.command.stamp - LEAD)
        frames = progress(range(len(truth.stamps)), len(truth.stamps))
        if images and (experiment.spatial or experiment.cameras or experiment.depth):
            record_pictures(experiment, truth, writer, frames, seed)
        elif images:
            warn_out_of_sight(experiment.geometry, truth)
            rod = experiment.truth.rod
            renderer = Renderer(experiment.geometry, experiment.look, rod.diameter, seed)
            record_board_pictures(experiment, truth, writer, frames, renderer, grips.places)
        else:
            for i, points, control_points in measure(experiment, truth, frames, seed):
                stamp = truth.stamps[i]
                cloud = points_message(BAG_MESSAGES, stamp, frame, points)
                writer.write(topics.OBSERVED_POINTS, cloud, stamp)
                spline = spline_message(BAG_MESSAGES, stamp, frame, control_points)
                writer.write(topics.OBSERVED, spline, stamp)
        writer.write_text("params.yaml", parameter_text(experiment))
        writer.write_text("truth.yaml", truth_text(experiment, truth))
    return truth


def measure(
    experiment: Experiment, truth: Truth, frames: Iterable[int], seed: int
) -> Iterator[tuple[int, CentrelinePoints, FloatArray]]:
    """Results as of an observer: points with noise across the rope, and their spline.

    Yields:
        Index of the frame, the points, and control points x, y, z [m], shape (n, 3); where twist is
        measured the twist angle [rad] beside them, (n, 4).
    """
    rod, measurement = experiment.truth.rod, experiment.measurement
    basis = SplineBasis(rod.control_points, rod.length)
    count = max(int(rod.length / measurement.spacing) + 1, 2 * rod.control_points)
    u = np.linspace(0.0, rod.length, count)
    step = 1e-3 * rod.length
    rng = np.random.default_rng(seed)
    for i in frames:

        def seen(at: FloatArray, i: int = i) -> FloatArray:
            time = (truth.stamps[i] - truth.stamps[0]) / NANOSECONDS
            return experiment.hidden.measured(truth.centreline(i, at), time)

        points = seen(u)
        tangent = seen(np.minimum(u + step, rod.length)) - seen(np.maximum(u - step, 0.0))
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        if truth.twist is None:
            across = np.column_stack([-tangent[:, 2], np.zeros(count), tangent[:, 0]])
            points = points + rng.normal(0.0, measurement.std, count)[:, None] * across
        else:
            noise = rng.normal(0.0, measurement.std, (count, 3))
            points = points + noise - np.sum(noise * tangent, axis=1, keepdims=True) * tangent
        std = np.full(count, measurement.std)
        spline = basis.fit(u, points)
        if truth.twist is not None and measurement.twist_std > 0.0:
            angle = truth.twist_angle(i, u) + rng.normal(0.0, measurement.twist_std, count)
            spline = np.column_stack([spline, basis.fit(u, angle[:, None])])
        yield i, CentrelinePoints(points, u, std), spline


def parameter_text(experiment: Experiment) -> str:
    """The parameter file beside the bag: what an experimenter would know, E and mu guessed."""
    cameras = {name: stated for name, (_, stated) in experiment.cameras.items()}
    return replace(experiment.guess, cameras=cameras).text(
        f"Parameters for the simulated experiment '{experiment.name}'.\n"
        "What was really simulated stands in truth.yaml."
    )


def truth_text(experiment: Experiment, truth: Truth) -> str:
    """YAML with the true parameters and effects and, for each image, the true spline.

    The control points are the least-squares projection of the true curve onto the published basis,
    ends kept; `projection_error` is their mean distance [m].
    """
    rod = experiment.truth.rod
    basis = SplineBasis(rod.control_points, rod.length)
    u = np.linspace(0.0, rod.length, 401)
    shapes, errors = [], []
    for i in range(len(truth.stamps)):
        q = truth.control_points(i, basis)
        miss = np.linalg.norm(basis.evaluate(q[:, :3], u) - truth.centreline(i, u), axis=1)
        errors.append(float(np.mean(miss)))
        shapes.append([[round(float(v), 7) for v in row] for row in q])
    flat = experiment.truth.flat()
    tree: dict[str, object] = {"experiment": experiment.name}
    for group in ("rod", "damping"):
        tree[group] = {
            name.partition(".")[2]: value
            for name, value in flat.items()
            if name.startswith(f"{group}.")
        }
    tree["gravity"] = list(experiment.truth.gravity)
    for block, effects in (
        ("effects", experiment.hidden.effects),
        ("foreign", experiment.hidden.foreign),
    ):
        if effects:
            tree[block] = {
                name: {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
                for name, values in effects.items()
            }
    if experiment.cameras:
        tree["cameras"] = {
            name: {
                "stated": {key: list(getattr(pose, key)) for key in POSE},
                "true": {key: list(getattr(experiment.hidden.camera(pose), key)) for key in POSE},
            }
            for name, (_, pose) in experiment.cameras.items()
        }
    tree["specific_modulus"] = rod.specific_modulus
    tree["stamps"] = list(truth.stamps)
    tree["projection_error"] = [round(e, 8) for e in errors]
    head = yaml.safe_dump(tree, sort_keys=False)
    body = yaml.safe_dump({"control_points": shapes}, default_flow_style=None, width=100)
    return f"# Truth of a simulated experiment; SI units, stamps in ns.\n{head}{body}"
