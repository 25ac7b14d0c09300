# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The experiment file: a rope of known properties, what moves it, and the camera that watches.

    parameters:          # the truth, written as in a parameter file
      rod: {length: 0.4, ...}
      camera: {translation: [...], rotation: [...]}
      command: {source: tf, start_frame: gripper}   # this frame in /tf, no dlo/command
      effects: {point_mass: {mass: 0.02, position: 0.3}}   # hidden in the simulated rope
    guess:               # what params.yaml says instead
      rod: {young_modulus: 1000000.0}
    duration: 3.0        # s
    initial_shape: [[x, z], ...]   # rough curve along which the rope is laid before it settles [m];
                                   # in space [[x, y, z], ...]
    motion:              # names of dlo/command; what is not named is free
      control_point_1:
        - {time: 0.0, position: [x, y, z]}
      end:
        - {time: 0.0, position: [x, y, z], angle: 0.0, swing: 0.0, turn: 0.0}
    camera: {...}        # intrinsics, see `picture_settings.SimulatedCamera`
    cameras: {NAME: {translation: [...], rotation: [...], ...}}   # several; keys as in `camera`
    depth: {...}         # a depth sensor beside the one camera, see `picture_settings.DepthSensor`
    look: {...}          # see `picture_settings.Look`
    measurement: {...}   # see `picture_settings.Measurement`
    wrench: {...}        # force-torque sensors at the grips, see `wrench_sensor.WrenchSensor`
    foreign: {...}       # effects that no parameter file names, see `hidden_effects.FOREIGN`

The parameters state what an experimenter knows; effects say how the truth departs from that. So
with `length_error` the rope is longer than `rod.length`, and with `camera_scale` or
`camera_rotation` the camera stands elsewhere than `camera` says. `guess` has no effects unless it
names some.

`angle` is the direction of growing u at a clamp, positive from x towards -z [rad]. In space the
clamp is then swung about its own z axis, out of the plane towards +y, by `swing`, and at last
turned about the rope by `turn`, which twists it (full turns add up). All three change linearly
between the points. Whatever leaves the plane y = 0 makes the whole experiment one in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dlo_ros.command import END, NANOSECONDS, START, Command
from dlo_ros.errors import CommandError, InputError, ParameterError
from dlo_ros.files import read_yaml
from dlo_ros.parameter_table import TABLE
from dlo_ros.parameters import EFFECTS_PREFIX, CameraPose, Settings
from dlo_ros.share import shared_file
from dlo_ros.spline import FloatArray
from dlo_ros.synthesis.camera_geometry import Geometry
from dlo_ros.synthesis.experiment_block import ExperimentBlock
from dlo_ros.synthesis.gripper_frames import check_frames
from dlo_ros.synthesis.hidden_effects import FOREIGN, HiddenEffects, read_effects
from dlo_ros.synthesis.hidden_rod import true_length
from dlo_ros.synthesis.picture_settings import DepthSensor, Look, Measurement, SimulatedCamera
from dlo_ros.synthesis.wrench_sensor import WrenchSensor

START_STAMP = 1_760_000_000 * NANOSECONDS
"""Stamp of the first image [ns], the same in every run so that bags are reproducible."""

FOLDER = "config/experiments"

EFFECTS_KEY = EFFECTS_PREFIX.rstrip(".")

ANGLES = ("angle", "swing", "turn")  # of a clamp: about its y, then z, then x axis

DURATIONS = (0.01, 3600.0)  # [s], the shortest and the longest
REACH = 1e3  # [m] positions further away are typing errors
UNIT = 1e-3  # by which the length of a quaternion may differ from 1
FLAT = 1e-9  # [m], [m/s^2] beside the plane y = 0 that is rounding
TURN = 1.5  # [rad] by which a clamp may turn between two points of a command, for slerp


@dataclass(frozen=True)
class Experiment:
    """A whole experiment file.

    Args:
        name: name of the experiment.
        truth: parameters of the simulated rope, and the camera's stated pose, without effects.
        guess: parameters that the parameter file beside the bag gives.
        duration: time from the first image to the last [s].
        initial_shape: rough curve x, z [m], shape (m, 2), or x, y, z, shape (m, 3).
        command: imposed motion; its stamp is the start of the recording.
        camera: intrinsics and quality.
        look: appearance of board and rope.
        measurement: noise where no images are made.
        hidden: effects that the truth has beside its parameters.
        cameras: several cameras by name, each with its stated pose; empty: the one camera.
        depth: the sensor beside the one camera; None: there is none.
        wrench: the sensors at the grips; None: there are none.
    """

    name: str
    truth: Settings
    guess: Settings
    duration: float
    initial_shape: FloatArray
    command: Command
    camera: SimulatedCamera
    look: Look
    measurement: Measurement
    hidden: HiddenEffects = field(default_factory=HiddenEffects)
    cameras: Mapping[str, tuple[SimulatedCamera, CameraPose]] = field(default_factory=dict)
    depth: DepthSensor | None = None
    wrench: WrenchSensor | None = None

    @property
    def camera_pose(self) -> CameraPose:
        """True pose of the camera; `truth` has the one that it is said to have."""
        return self.hidden.camera(self.truth.camera)

    @property
    def geometry(self) -> Geometry:
        """The one camera where it really stands."""
        return Geometry(self.camera, self.camera_pose)

    @property
    def spatial(self) -> bool:
        """Whether anything leaves the plane y = 0."""
        command, shape = self.command, self.initial_shape
        return bool(
            command.off_plane > FLAT
            or not command.turns_in_plane
            or (shape.shape[1] == 3 and np.abs(shape[:, 1]).max() > FLAT)
            or abs(self.truth.gravity[1]) > FLAT
            or self.hidden.sideways
        )

    @property
    def stamps(self) -> list[int]:
        """Stamps of the images [ns]."""
        count = int(np.floor(self.duration * self.camera.rate + 1e-6)) + 1
        return [START_STAMP + round(k / self.camera.rate * NANOSECONDS) for k in range(count)]


def load_experiment(path: Path | str) -> Experiment:
    """Read an experiment file.

    Raises:
        InputError: the file is missing, is no YAML, or holds something unusable.
    """
    path = Path(path)
    return read_experiment(read_yaml(path), path.stem, str(path))


def read_experiment(tree: Any, name: str, where: str) -> Experiment:
    """Check and convert the content of an experiment file.

    Args:
        tree: content of the file as YAML gives it.
        name: name of the experiment, where the file has no `name`.
        where: name of the file, for error messages.

    Raises:
        InputError: something is missing, unknown or out of range.
    """
    top = ExperimentBlock(tree, where)
    name = str(top.raw("name", name))
    top.raw("description")
    given = top.required("parameters", "the rope's true parameters")
    parameters = _flat(_without_effects(given), where)
    override = _flat(top.raw("guess", {}), where)
    effects = given.get(EFFECTS_KEY) if isinstance(given, Mapping) else None
    try:
        truth = Settings.from_mapping(parameters)
        guess = Settings.from_mapping({**parameters, **override})
    except ParameterError as err:
        raise InputError(f"{where}: {err}") from err
    experiment = Experiment(
        name=name,
        truth=truth,
        guess=guess,
        duration=top.number("duration", 3.0, *DURATIONS),
        initial_shape=_curve(top),
        command=_motion(top.block("motion"), truth),
        camera=_finished(SimulatedCamera.read, top.block("camera")),
        look=_finished(Look.read, top.block("look")),
        measurement=_finished(Measurement.read, top.block("measurement")),
        hidden=HiddenEffects(
            effects=read_effects(effects, f"{where}: {EFFECTS_KEY}"),
            foreign=read_effects(top.raw("foreign"), f"{where}: foreign", FOREIGN),
        ),
        cameras=_cameras(top),
        depth=_finished(DepthSensor.read, top.block("depth")) if "depth" in top else None,
    )
    if "wrench" in top:
        experiment = with_wrench(experiment, _finished(WrenchSensor.read, top.block("wrench")))
    if experiment.cameras and experiment.depth is not None:
        raise InputError(f"{where}: depth is that of the one camera; leave cameras or depth out")
    top.finish()
    _check_effects(experiment, where)
    check_frames(truth, experiment.command, where)
    _check_reach(experiment.command, true_length(truth, experiment.hidden), where)
    return experiment


def with_wrench(experiment: Experiment, sensor: WrenchSensor | None = None) -> Experiment:
    """The experiment with sensors at the grips, whose errors its parameter file states.

    Args:
        sensor: default: one with a noise of 1 % and an offset of 5 % of the rope's weight.
    """
    rod = experiment.truth.rod
    if sensor is None:
        weight = rod.linear_density * rod.length * float(np.linalg.norm(experiment.truth.gravity))
        sensor = WrenchSensor.usual(weight, rod.length)
    stated = replace(
        experiment.guess.wrench, force_std=sensor.force_std, torque_std=sensor.torque_std,
        force_bias_std=sensor.force_bias_std,
    )  # fmt: skip
    return replace(experiment, wrench=sensor, guess=replace(experiment.guess, wrench=stated))


def _finished(read: Any, section: ExperimentBlock) -> Any:
    result = read(section)
    section.finish()
    return result


def _cameras(top: ExperimentBlock) -> dict[str, tuple[SimulatedCamera, CameraPose]]:
    """The block `cameras`; their pictures come at the rate of `camera`."""
    section, rate = top.block("cameras"), SimulatedCamera.read(top.block("camera")).rate
    result = {}
    for name in section.names:
        if not name.isidentifier():
            raise InputError(f"{section.where}: '{name}' is no name for a topic; use letters, _")
        block = section.block(name)
        if "rate" in block:
            raise InputError(f"{block.where}: all have one rate; give it in `camera`")
        for key in ("translation", "rotation"):
            block.required(key, "the pose of the board in the camera, as in `camera` of parameters")
        x, y, z = block.numbers("translation", (0.0, 0.0, 0.0), -REACH, REACH)
        rotation = np.array(block.numbers("rotation", (0.0, 0.0, 0.0, 1.0), -1.0, 1.0))
        if abs(np.linalg.norm(rotation) - 1.0) > UNIT:
            raise InputError(f"{block.where}: rotation is no unit quaternion (x, y, z, w)")
        qx, qy, qz, qw = (float(v) for v in rotation / np.linalg.norm(rotation))
        camera = replace(SimulatedCamera.read(block), rate=rate)
        block.finish()
        result[name] = camera, CameraPose(translation=(x, y, z), rotation=(qx, qy, qz, qw))
    if len(result) == 1:
        raise InputError(
            f"{section.where}: has '{name}' alone; give two or more, or leave it out and give the "
            "one as `camera`, its pose in `camera` of parameters"
        )
    return result


def _flat(block: Any, where: str, prefix: str = "") -> dict[str, Any]:
    """Dotted names of a tree of parameters, all of them known."""
    if not isinstance(block, Mapping):
        raise InputError(f"{where}: {prefix or 'parameters'} must be a block of 'key: value'")
    result: dict[str, Any] = {}
    for key, value in block.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            result |= _flat(value, where, f"{name}.")
        elif name in TABLE or name.startswith(EFFECTS_PREFIX):
            result[name] = value
        else:
            raise InputError(f"{where}: '{name}' is no parameter; known are {', '.join(TABLE)}")
    return result


def _without_effects(block: Any) -> Any:
    if not isinstance(block, Mapping):
        return block
    return {key: value for key, value in block.items() if key != EFFECTS_KEY}


def _check_effects(experiment: Experiment, where: str) -> None:
    """Refuse effects that are wrong for this rope only.

    Raises:
        InputError: no length is left, or something lies beyond the rope's end.
    """
    length, hidden = experiment.truth.rod.length, experiment.hidden
    shortest = true_length(experiment.truth, hidden)
    shortest += min(hidden.number("clamp_slip", "length"), 0.0)
    if shortest < 0.5 * length:
        raise InputError(f"{where}: effects leave {shortest:g} m of a rope of {length:g} m")
    places = (
        ("point_mass", "position"),
        ("intrinsic_curvature", "position"),
        ("stiff_segment", "centre"),
        ("connector", "extent"),
    )
    for name, key in places:
        place = hidden.number(name, key)
        if place > length:
            raise InputError(
                f"{where}: effects.{name}.{key} is {place:g} m; the rope is {length:g} m long"
            )


def _curve(top: ExperimentBlock) -> FloatArray:
    points = top.required("initial_shape", "a rough curve, a list of [x, z] or [x, y, z] in m")
    if not isinstance(points, list) or len(points) < 2:
        raise InputError(
            f"{top.where}: initial_shape must be a list of at least two [x, z] or [x, y, z]"
        )
    axes = 3 if isinstance(points[0], (list, tuple)) and len(points[0]) == 3 else 2
    return np.array([top.check_all(p, "initial_shape", axes, -REACH, REACH) for p in points])


def _motion(section: ExperimentBlock, truth: Settings) -> Command:
    """The command of the block `motion`: all names get points at all the times that occur."""
    names = section.names
    tracks: list[tuple[list[float], FloatArray]] = []
    for name in names:
        points = section.raw(name)
        if not isinstance(points, list) or not points:
            raise InputError(f"{section.where}: {name} must be a list of {{time, position}}")
        times, rows = [], []
        for point in points:
            entry = ExperimentBlock(point, f"{section.where}: {name}")
            times.append(entry.number("time", 0.0, 0.0, 1e5))
            position = entry.required("position", "[x, y, z] in m")
            row = [*entry.check_all(position, "position", 3, -REACH, REACH), 0.0, 0.0, 0.0]
            if name in (START, END):
                entry.required("angle", "the clamp's direction in rad")
                row[3:] = (entry.number(key, 0.0, -1e3, 1e3) for key in ANGLES)
            rows.append(row)
            entry.finish()
        if any(b <= a for a, b in pairwise(times)):
            raise InputError(f"{section.where}: the times of {name} must grow")
        tracks.append((times, np.array(rows)))
    every = np.unique(np.concatenate([t for t, _ in tracks])) if tracks else np.zeros(1)
    every = _refined(every, tracks)
    positions = np.zeros((len(every), len(names), 3))
    rotations = np.zeros((len(every), len(names), 4))
    for k, (at, values) in enumerate(tracks):
        between = np.column_stack([np.interp(every, at, column) for column in values.T])
        positions[:, k] = between[:, :3]
        rotations[:, k] = Rotation.from_euler("YZX", between[:, 3:]).as_quat()
    try:
        return Command(
            stamp=START_STAMP,
            names=names,
            times=every,
            positions=positions,
            rotations=rotations,
            velocities=np.full_like(positions, np.nan),
            control_points=truth.rod.control_points,
            frame_id=truth.frame_id,
        )
    except CommandError as err:
        raise InputError(f"{section.where}: {err}") from err


def _refined(times: FloatArray, tracks: list[tuple[list[float], FloatArray]]) -> FloatArray:
    """Times between which no clamp turns so far that slerp would take the other way round."""
    result = [times[:1]]
    for a, b in pairwise(times):
        turns = [
            sum(np.ptp(np.interp([a, b], t, angles)) for angles in rows[:, 3:].T)
            for t, rows in tracks
        ]
        pieces = int(np.ceil(max(turns, default=0.0) / TURN)) or 1
        result.append(np.linspace(a, b, pieces + 1)[1:])
    return np.concatenate(result)


def _check_reach(command: Command, length: float, where: str) -> None:
    """Both ends held further apart than the rope is long cannot be simulated."""
    first = [k for k, n in enumerate(command.names) if n in (START, "control_point_1")]
    last_name = f"control_point_{command.control_points}"
    last = [k for k, n in enumerate(command.names) if n in (END, last_name)]
    if not first or not last:
        return
    apart = np.linalg.norm(command.positions[:, first[0]] - command.positions[:, last[0]], axis=1)
    worst = int(np.argmax(apart))
    if apart[worst] > length:
        raise InputError(
            f"{where}: the ends are {apart[worst]:.3f} m apart at {command.times[worst]:g} s, "
            f"but the rope is {length:g} m long"
        )


def find_experiment(name: str) -> Path:
    """File of an experiment that is given by its path or its bundled name.

    Raises:
        InputError: there is none; the message lists the bundled ones.
    """
    if Path(name).is_file():
        return Path(name)
    folder = shared_file(f"{FOLDER}/c_shape.yaml").parent
    bundled = {path.stem: path for path in folder.glob("*.yaml")}
    if name in bundled:
        return bundled[name]
    known = ", ".join(sorted(bundled))
    raise InputError(f"{name}: no such experiment file; bundled experiments are {known}")
