# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of dark ropes on dark ground, and of ropes in a robot's cell, for vision_stress.py.

Kind and all else follow from the seed.
"""

import cv2
import numpy as np
from vision_kinds import base, cloth, colour, shape
from vision_scenes import to_board

DARK = ("cloth", "shine", "shadow")
CELL = ("arm", "edge", "window")


def make_dark(seed):
    """Kind, true curve and scene: a black cable on black cloth, its highlight, its shadow."""
    rng = np.random.default_rng([29, seed])
    kind = DARK[seed % len(DARK)]
    scene = base(rng, seed)
    tone = rng.uniform(25, 60)
    scene.painted = np.clip(0.35 * cloth(rng, scene.size), 0, 255)
    scene.painted *= tone / scene.painted.mean()
    scene.rope = tuple(
        int(v) for v in np.clip(tone - rng.uniform(12, 30) + rng.normal(0, 2, 3), 2, 255)
    )
    scene.texture, scene.shade, scene.gradient = rng.uniform(0, 4), rng.uniform(-6, 6), 10.0
    if kind == "shine":
        scene.highlight = rng.uniform(30, 120)
    elif kind == "shadow":
        scene.cast = rng.uniform(0.4, 0.8)
    return kind, shape(rng, crossing=False), scene


def make_cell(seed):
    """Kind, true curve and scene: behind the rope an arm, the edge of a table, a wall, a window."""
    rng = np.random.default_rng([31, seed])
    kind = CELL[seed % len(CELL)]
    scene = base(rng, seed)
    curve = shape(rng, crossing=False)
    w, h = scene.size
    canvas = np.ones((h, w, 3)) * colour(rng, 120, 235)  # the wall
    table = int(rng.uniform(0.35, 0.85) * h)
    canvas[table:] = colour(rng, 60, 200)
    cv2.line(canvas, (0, table), (w, table), colour(rng, 30, 120), int(rng.uniform(2, 14)))
    if kind == "window":
        x, y = int(rng.uniform(0, 0.6) * w), int(rng.uniform(0, 0.3) * h)
        right, low = x + int(rng.uniform(0.15, 0.4) * w), y + int(rng.uniform(0.2, 0.5) * h)
        cv2.rectangle(canvas, (x, y), (right, low), (255, 255, 255), -1)
        frame = colour(rng, 40, 160)
        cv2.rectangle(canvas, (x, y), (right, low), frame, int(rng.uniform(6, 16)))
        cv2.line(canvas, ((x + right) // 2, y), ((x + right) // 2, low), frame, 10)
    if kind == "arm":
        grip = scene.camera().project(to_board(curve[:1]))[0]
        joint = grip
        grey = rng.uniform(60, 230)
        angle = rng.uniform(0, 2 * np.pi)
        for thick in (1.6, 4.0, 7.0, 9.0):  # the gripper, then ever thicker links
            angle += rng.uniform(-1.0, 1.0)
            end = joint + rng.uniform(8, 16) * scene.width_px * np.array(
                [np.cos(angle), np.sin(angle)]
            )
            ends = [tuple(int(v) for v in p) for p in (joint, end)]
            cv2.line(canvas, *ends, (grey,) * 3, int(thick * scene.width_px), cv2.LINE_AA)
            cv2.circle(canvas, ends[1], int(0.6 * thick * scene.width_px), (0.7 * grey,) * 3, -1)
            joint = end
    scene.painted = cv2.GaussianBlur(canvas, (0, 0), 1.0)
    tones = scene.painted.reshape(-1, 3)[::997]
    scene.rope = max(
        (colour(rng) for _ in range(12)),
        key=lambda c: np.percentile(np.linalg.norm(tones - c, axis=1), 10),
    )
    return kind, curve, scene
