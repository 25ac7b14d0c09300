# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Inputs that residuals depend on: what was put in is found, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from measured import at_rest, swing
from rods import PAPER, command

from dlo_ros.diagnosis.residuals.recorded_inputs import Input, inputs
from dlo_ros.diagnosis.residuals.relations import relate, relations, sentences
from dlo_ros.identification import Manipulation
from dlo_ros.inference.measured import Recording, measured
from dlo_ros.observation import Observation

N, LENGTH = PAPER.rod.control_points, PAPER.rod.length
RATE, FRAMES = 30.0, 90


def carried(seed, frames=FRAMES, amplitude=0.1, space=False):
    """A grip that goes to and fro at random, the DLO hanging below it and lagging behind."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / RATE
    waves = [(rng.uniform(0.3, 2.0), rng.uniform(0.0, 6.3), rng.normal()) for _ in range(4)]

    def x(t):
        return amplitude * sum(a * np.sin(6.28 * f * t + p) / 4.0 for f, p, a in waves)

    fine = np.arange(0.0, times[-1] + 0.2, 0.01)
    way = np.zeros((len(fine), 1, 3))
    way[:, 0, 0] = x(fine)
    if space:
        way[:, 0, 1] = 0.5 * x(fine + 0.7)
    imposed = command(["start"], fine, way, stamp=1)
    depth = np.linspace(0.0, 1.0, N)
    shapes = np.zeros((frames, N, 4))
    shapes[:, :, 0] = x(times[:, None] - 0.15 * depth)
    shapes[:, :, 1] = 0.5 * x(times[:, None] + 0.7 - 0.15 * depth) if space else 0.0
    shapes[:, :, 2] = -LENGTH * depth
    seen = tuple(
        Observation(1 + round(t * 1e9), s) for t, s in zip(times, shapes, strict=True)
    )  # fmt: skip
    return measured(Manipulation(f"carried {seed}", (imposed,), seen), PAPER), shapes


def several(count, **keywords):
    pairs = [carried(10 * count + k, **keywords) for k in range(count)]
    return [r for r, _ in pairs], [p for _, p in pairs]


def smooth(rng, recording: Recording):
    """A pattern along the DLO."""
    pattern = np.zeros(recording.across.shape[1])
    pattern[:N] = np.sin(np.pi * np.linspace(0.0, rng.uniform(0.5, 2.0), N))
    return pattern


def columns(recordings, shapes, name):
    (found,) = [i for i in inputs(recordings, shapes, PAPER) if i.name == name]
    return found.columns


def noisy(rng, recordings, amplitudes, level):
    pattern = smooth(rng, recordings[0])
    return [
        level * np.outer(a / np.std(np.concatenate(amplitudes)), pattern)
        + rng.normal(size=(len(a), len(pattern)))
        for a in amplitudes
    ]


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("space", [False, True])
def test_a_residual_that_is_made_of_speed_is_told_as_speed(count, space):
    recordings, shapes = several(count, space=space)
    speed = [c[:, 0] for c in columns(recordings, shapes, "the speed of the grip")]
    residuals = noisy(np.random.default_rng(0), recordings, speed, 3.0)
    found = relations(recordings, residuals, shapes, PAPER)
    assert [r.name for r in found.significant] == ["the speed of the grip"]
    (told,) = found.significant
    assert told.alike == ()
    assert told.chance <= 0.02
    assert told.share > 0.7
    assert found.constant > 0.5  # speed has a mean
    assert found.pattern is not None and found.pattern.share > 0.8
    position = next(r for r in found.inputs if r.name == "the position of the grip")
    assert not position.significant and position.share < 0.3
    words = "\n".join(sentences(found))
    assert "depends on the speed of the grip" in words and "position" not in words


def test_position_is_told_from_speed():
    recordings, shapes = several(3)
    place = [c[:, 0] for c in columns(recordings, shapes, "the position of the grip")]
    found = relations(
        recordings, noisy(np.random.default_rng(1), recordings, place, 3.0), shapes, PAPER
    )
    best = found.significant[0]
    assert "the position of the grip" in (best.name, *best.alike)
    assert "the speed of the grip" not in {n for r in found.significant for n in (r.name, *r.alike)}


def test_two_inputs_are_told_one_after_the_other():
    recordings, shapes = several(4)
    rng = np.random.default_rng(2)
    speed = [c[:, 0] for c in columns(recordings, shapes, "the speed of the grip")]
    place = [c[:, 0] for c in columns(recordings, shapes, "the position of the grip")]
    first, second = (noisy(rng, recordings, a, 3.0) for a in (speed, place))
    found = relations(
        recordings, [a + b for a, b in zip(first, second, strict=True)], shapes, PAPER
    )
    names = [{r.name, *r.alike} for r in found.significant]
    assert any("the speed of the grip" in n for n in names)
    assert any("the position of the grip" in n for n in names)


def test_noise_is_silent():
    recordings, shapes = several(2)
    told = 0
    for seed in range(100):
        rng = np.random.default_rng([3, seed])
        residuals = [rng.normal(size=(len(r.times), len(r.noise))) for r in recordings]
        told += bool(relations(recordings, residuals, shapes, PAPER).significant)
    assert told <= 1


@pytest.mark.parametrize("count", [1, 2])
def test_a_drift_is_not_explained_by_what_varies_slowly(count):
    """Both go one way through the whole recording: everything that does is alike."""
    times = np.arange(FRAMES) / RATE
    told = 0
    for seed in range(25):
        rng = np.random.default_rng([4, count, seed])
        slow = [times[:, None] ** rng.uniform(0.7, 2.0) + 0.1 * times[:, None] ** 2
                for _ in range(count)]  # fmt: skip
        fields = [
            8.0 * np.outer((times / 3.0) ** rng.uniform(0.7, 2.0), rng.normal(size=12))
            + rng.normal(size=(FRAMES, 12))
            for _ in range(count)
        ]
        found, _ = relate(fields, [times] * count, [Input("a slow input", tuple(slow))], seed)
        told += any(r.significant for r in found)
    assert told <= 1


def test_what_swings_by_itself_is_no_relation():
    """A line in the spectrum has only its phase to be alike by chance."""
    times = np.arange(FRAMES) / RATE
    told = 0
    for seed in range(40):
        rng = np.random.default_rng([5, seed])
        wave = np.sin(2.0 * np.pi * 1.1 * times + rng.uniform(0.0, 6.3))
        field = 5.0 * np.outer(wave, rng.normal(size=12)) + rng.normal(size=(FRAMES, 12))
        varied = Input("a wave", (np.sin(2.0 * np.pi * 1.1 * times)[:, None],))
        found, _ = relate([field], [times], [varied], seed)
        told += any(r.significant for r in found)
    assert told <= 4  # a tenth: one recording of one wave says no more than that


def test_nothing_moves_in_a_static_recording():
    still = measured(at_rest(PAPER, frames=15, same=False), PAPER)
    shapes = np.concatenate([still.observed, np.zeros((15, N, 1))], axis=2)
    shapes[:] = shapes[0]
    names = [i.name for i in inputs([still], [shapes], PAPER)]
    assert names == ["the time since the start"]
    rng = np.random.default_rng(6)
    residual = 2.0 * smooth(rng, still) + 0.3 * rng.normal(size=(15, len(still.noise)))
    found = relations([still], [residual], [shapes], PAPER)
    assert found.significant == () and found.constant > 0.9
    assert "stays the same" in sentences(found)[0]
    one = relations([still], [residual[:1]], [shapes[:1]], PAPER)
    assert one.significant == () and one.inputs == ()


def test_residuals_may_begin_a_frame_later():
    """With `start: moving` the first picture only gives the velocity."""
    recordings, shapes = several(2)
    speed = [c[1:, 0] for c in columns(recordings, shapes, "the speed of the grip")]
    residuals = noisy(np.random.default_rng(7), recordings, speed, 3.0)
    found = relations(recordings, residuals, [s[1:] for s in shapes], PAPER)
    assert "the speed of the grip" in found.significant[0].name


def test_recordings_in_the_plane_and_in_space_go_together():
    flat, flat_shapes = carried(70)
    deep, deep_shapes = carried(71, space=True)
    recordings, shapes = [flat, deep], [flat_shapes, deep_shapes]
    assert flat.across.shape[1] == 2 * N and deep.across.shape[1] == 3 * N
    rng = np.random.default_rng(8)
    speed = [c[:, 0] for c in columns(recordings, shapes, "the speed of the grip")]
    flat_residual, deep_residual = noisy(rng, recordings, speed, 3.0)
    deep_residual = np.pad(deep_residual, [(0, 0), (0, N)])
    deep_residual[:, 2 * N :] += rng.normal(size=(FRAMES, N))
    found = relations(recordings, [flat_residual, deep_residual], shapes, PAPER)
    assert "the speed of the grip" in found.significant[0].name


def test_a_turning_clamp_has_an_orientation_and_a_speed():
    recording = measured(swing(PAPER, seconds=1.0, noise=0.0), PAPER)
    shapes = np.concatenate([recording.observed, np.zeros((31, N, 1))], axis=2)
    found = {i.name: i.columns[0] for i in inputs([recording], [shapes], PAPER)}
    assert "the position of the grip" not in found  # it only turns
    speed = found["the speed of the grip"][:, 0]
    turning = recording.times < 0.28
    # 60 degrees in 0.3 s, at half the length from the clamp.
    assert np.median(speed[turning]) == pytest.approx(np.pi / 3 / 0.3 * LENGTH / 2, rel=0.05)
    assert np.abs(speed[recording.times > 0.4]).max() < 0.01
    assert "the orientation of the grip to gravity" in found
    pins = command(["control_point_1", "control_point_2"], [0.0, 1.0],
                   [[[0, 0, 0], [0.1, 0, 0]], [[0, 0, 0], [0, 0, -0.1]]])  # fmt: skip
    pinned = replace(recording, manipulation=replace(recording.manipulation, commands=(pins,)))
    names = {i.name for i in inputs([pinned], [shapes], PAPER)}
    assert "the orientation of the grip to gravity" in names
    assert "the position of the grip" not in names
