# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Pictures of a case: another light, other ropes and boards, blur, noise, things that lie about."""

import cv2
import numpy as np

from dlo_ros.synthesis.render import Renderer

ROPES = ((36, 52, 118), (30, 30, 32), (150, 40, 35), (20, 90, 60), (215, 140, 30))
"""Red, green, blue of the ropes' colours."""


def drawn(rng: np.random.Generator) -> dict:
    """Blocks `camera` and `look` of an experiment file: how a case is seen."""
    tone = rng.uniform(180.0, 235.0)
    hole = float(rng.choice([0.0, 0.003, 0.004]))
    camera = {
        "noise": float(rng.uniform(1.0, 5.0)), "blur": float(rng.uniform(0.4, 1.2)),
        "exposure": float(rng.uniform(0.0, 0.006)), "jpeg_quality": int(rng.integers(75, 96)),
        "distortion": [float(-0.1 * rng.random()), float(0.03 * rng.random()), 0.0, 0.0, 0.0],
    }  # fmt: skip
    look = {
        "board_colour": [float(tone + rng.uniform(-10.0, 10.0)) for _ in range(3)],
        "rope_colour": [float(v) for v in ROPES[rng.integers(len(ROPES))]],
        "hole_diameter": hole, "hole_pitch": float(rng.uniform(0.018, 0.03)),
        "grain": float(rng.uniform(1.0, 6.0)), "unevenness": float(rng.uniform(0.1, 0.5)),
        "shadow": float(rng.uniform(0.1, 0.5)), "strand_contrast": float(rng.uniform(0.0, 0.5)),
    }  # fmt: skip
    return {"camera": camera, "look": look}


class Cluttered(Renderer):
    """A board on which labels, tools and pieces of cable lie."""

    def _board(self, plane: np.ndarray) -> np.ndarray:
        board = super()._board(plane).copy()
        size = np.array(board.shape[1::-1], float)
        for _ in range(int(self._rng.integers(0, 5))):
            colour = tuple(float(v) for v in self._rng.uniform(40.0, 250.0, 3))
            middle = self._rng.random(2) * size
            if self._rng.random() < 0.5:
                half = self._rng.uniform(0.01, 0.05, 2) * size
                box = cv2.boxPoints((middle, 2.0 * half, float(self._rng.uniform(0.0, 180.0))))
                cv2.fillPoly(board, [np.int32(box)], colour, cv2.LINE_AA)
            else:
                walk = np.cumsum(self._rng.normal(0.0, 0.05, (4, 2)), axis=0) * size.min()
                width = int(self._rng.integers(2, 12))
                cv2.polylines(board, [np.int32(middle + walk)], False, colour, width, cv2.LINE_AA)
        return board
