# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Contact sheet: what the vision stage finds in many photographs, on one picture.

    python -m dlo_ros.vision.contact_sheet --output sheet.png PHOTO ...

Each photograph is searched as `observe` searches image files, and drawn with the centrelines that
were found and their number. Made to be looked at after a change.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from dlo_ros.errors import DloError, InputError
from dlo_ros.files import write_bytes
from dlo_ros.vision.overlay import PALETTE, draw_curve, write_message
from dlo_ros.vision.photograph import find_dlos
from dlo_ros.vision.segmentation.ridge_map import Image

TILE = 480  # [px] larger side of a photograph on the sheet
COLUMNS = 4


def tile(path: Path) -> Image:
    """One photograph with what was found in it, shape (TILE, TILE, 3).

    Raises:
        InputError: it cannot be read.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(f"{path}: is no image that can be read")
    image = np.asarray(image, dtype=np.uint8)
    dlos = find_dlos(image)
    scale = TILE / max(image.shape[:2])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    for number, dlo in enumerate(dlos):
        draw_curve(
            small, (dlo.pixels + 0.5) * scale - 0.5, PALETTE[number % len(PALETTE)], dlo.seen
        )
    write_message(small, f"{path.stem[:24]}: {len(dlos)}")
    canvas = np.zeros((TILE, TILE, 3), dtype=np.uint8)
    canvas[: size[1], : size[0]] = small
    return canvas


def sheet(paths: list[Path]) -> Image:
    """All photographs side by side."""
    tiles = [tile(path) for path in paths]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % min(COLUMNS, len(tiles)))
    columns = min(COLUMNS, len(tiles))
    rows = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
    return np.asarray(np.vstack(rows), dtype=np.uint8)


def main() -> int:
    """Make the sheet; returns the exit status."""
    parser = argparse.ArgumentParser(description="centrelines found in photographs, on one picture")
    parser.add_argument("photos", nargs="+", type=Path, metavar="PHOTO")
    parser.add_argument("--output", type=Path, required=True, metavar="PNG")
    arguments = parser.parse_args()
    try:
        if arguments.output.suffix.lower() != ".png":
            raise InputError(f"{arguments.output}: is written as PNG; give a name that ends so")
        _, data = cv2.imencode(".png", sheet(arguments.photos))
        write_bytes(arguments.output, data.tobytes())
    except DloError as err:
        print(err, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
