# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Write one challenge: `python -m challenge --seed 3 --kind pair --output build/challenge`."""

import argparse
import time
from pathlib import Path

from challenge import KINDS, draw


def main() -> None:
    parser = argparse.ArgumentParser(prog="challenge", description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, default="single")
    parser.add_argument("--effect", action="append", default=[], help="instead of drawing one")
    parser.add_argument("--images", action="store_true", help="render a camera")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    began = time.process_time()
    challenge = draw(arguments.seed, arguments.kind, tuple(arguments.effect))
    drawn = time.process_time()
    bags = challenge.write(arguments.output, images=arguments.images)
    each = (time.process_time() - drawn) / len(bags)
    for bag in bags:
        print(bag)
    print(f"hidden: {challenge.effects | challenge.foreign or 'nothing'}")
    print(f"residual over noise, E and mu fitted again: {challenge.ratio}")
    print(f"drawn in {drawn - began:.1f} s, {each:.1f} s for each recording")


if __name__ == "__main__":
    main()
