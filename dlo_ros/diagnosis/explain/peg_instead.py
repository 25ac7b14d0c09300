# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A peg in the place of a wall, which a DLO that touches it in one place hardly shows.

Walls are tried from where shapes would go furthest; a peg is proposed only where it explains
outlier frames by itself, which beside other causes it may not.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from dlo_ros.diagnosis.contact.contact_search import RADII
from dlo_ros.diagnosis.contact.peg_places import TouchedPeg
from dlo_ros.diagnosis.contact.wall_places import normal
from dlo_ros.diagnosis.explain.cause_search import Search
from dlo_ros.diagnosis.explain.contact_trials import Contact, begun_in_place
from dlo_ros.diagnosis.explain.trials import FIT_ITERATIONS, Trial, gains
from dlo_ros.diagnosis.explain.turned_walls import WALL, touched
from dlo_ros.diagnosis.proposals.linear_evidence import Proposal
from dlo_ros.effects import Start
from dlo_ros.effects.physics.obstacle import Obstacle
from dlo_ros.effects.physics.wall import StraightWall
from dlo_ros.inference.joint import Evaluation
from dlo_ros.inference.joint_fit import fit, nearest_err
from dlo_ros.inference.measured import Recording
from dlo_ros.inference.model_comparison import tells_apart
from dlo_ros.inference.parameter import value_of
from dlo_ros.inference.thresholds import LOWERS

LOG = logging.getLogger(__name__)


def with_peg_or_wall(
    found: Search, contact: Contact | None, recordings: Sequence[Recording]
) -> tuple[Search, Contact | None]:
    """A search's result with a peg for its wall where that comes nearer, or as its rival.

    Args:
        contact: what was hit as it is known so far; None: nothing.

    Returns:
        The result, and what was hit with its rivals.
    """
    wall = found.cause_of(StraightWall.name)
    known = contact.rivals if contact is not None else {}
    has_peg = Obstacle.name in known or found.cause_of(Obstacle.name) is not None
    peg = peg_instead(found.at, wall, recordings) if wall and not has_peg else None
    if wall is None or peg is None:
        return found, contact
    round_, flat = (nearest_err(e, recordings) for e in (peg[0], found.at))
    if round_ < (1.0 - LOWERS) * flat:  # the peg's fit has just gone on, and the wall's has not
        found = replace(found, at=fit(found.at, recordings, FIT_ITERATIONS))
        flat = nearest_err(found.at, recordings)
    LOG.info("a peg instead of the wall: %.3f mm, %.3f mm with it", 1e3 * round_, 1e3 * flat)
    nearer = round_ < (1.0 - LOWERS) * flat and not tells_apart(found.at, peg[0])
    as_near = (1.0 - LOWERS) * round_ <= flat
    if nearer or (as_near and gains(peg, found.at)):
        hit = Contact.of(peg, (found.at, wall), as_near=not nearer)
        return found.exchanged(wall, peg), hit
    hit = Contact.of((found.at, wall), peg, as_near=as_near)
    return found, replace(hit, rivals={**known, **hit.rivals})


def peg_instead(at: Evaluation, wall: Proposal, recordings: Sequence[Recording]) -> Trial | None:
    """The fit with a peg where the DLO touches a wall; of several sizes the one that comes nearest
    by its first steps.

    A fit that has only begun tells of no more than the size: a peg that is right to 3 mm lay three
    times as far off as the wall.

    Args:
        at: a fit with the wall.
        wall: the wall, of which all is left out.
    """
    tried = [begun_in_place(at, wall, start, recordings) for start in pegs_touched(at)]
    found = [trial for trial in tried if trial is not None]
    if not found:
        return None
    begun, proposal = min(found, key=lambda trial: trial[0].mean_err)
    return fit(begun, recordings, FIT_ITERATIONS), proposal


def pegs_touched(at: Evaluation) -> list[Start]:
    """Pegs of several sizes in the place of a model's wall, in touch with what it touches."""
    settings = at.model.settings
    offset, angle = (value_of(settings, name) for name in WALL)
    away, place = normal(angle), touched(at)
    surface = place - (float(place @ away) - offset) * away
    centres = [surface - radius * away for radius in RADII]
    return [
        TouchedPeg(float(x), float(z), radius).start(settings.rod.diameter)
        for (x, z), radius in zip(centres, RADII, strict=True)
    ]
