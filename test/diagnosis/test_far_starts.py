# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""A weight that outweighs the cable, whose stiffness is guessed five times too small."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from rods import PAPER

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis.explain.far_starts import best_far_start, in_its_place
from dlo_ros.diagnosis.explain.joint_explanation import prepare
from dlo_ros.diagnosis.proposals.linear_evidence import proposal_of, with_proposals
from dlo_ros.effects import Start, starts
from dlo_ros.identification.estimate import searchable
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.inference.joint_fit import fit
from dlo_ros.inference.losses import WHITE, misfit
from dlo_ros.inference.model_comparison import tells_apart
from dlo_ros.inference.parameter import ParametricModel
from dlo_ros.parameters import Settings
from dlo_ros.synthesis.experiment import read_experiment
from dlo_ros.synthesis.synthesize import synthesize

LENGTH, ANGLES = 0.45, (0.8, 2.2)
CABLE = {
    "rod": {
        "length": LENGTH, "diameter": 0.012, "young_modulus": 3e7, "density": 3000.0,
        "density_std": 30.0,
    },
    "damping": {"air_drag": 0.05, "relaxation_time": 0.05},
    "camera": {"translation": [0.0, 0.0, 1.6]},
}  # fmt: skip
LOAD = 1.5 * CABLE["rod"]["density"] * np.pi / 4 * CABLE["rod"]["diameter"] ** 2 * LENGTH
WEIGHT = {"point_mass": {"mass": LOAD, "position": LENGTH}}
PLUG = {"connector": {"mass": LOAD, "extent": 0.1 * LENGTH}}


def turned(sign, effects):
    """The cable hangs from a flange, which turns it through some poses."""
    points = [{"time": 0.0, "position": [0.0, 0.0, 0.0], "angle": -np.pi / 2}]
    for k, angle in enumerate(ANGLES):
        for time in (1.5 * k + 1.0, 1.5 * k + 1.5):
            points.append(
                {"time": time, "position": [0.0, 0.0, 0.0], "angle": sign * angle - np.pi / 2}
            )
    return {
        "parameters": CABLE | {"effects": effects},
        "duration": 1.5 * len(ANGLES), "camera": {"rate": 10.0}, "motion": {"start": points},
        "initial_shape": [[0.0, 0.0], [0.0, -0.4]], "measurement": {"std": 3e-4},
    }  # fmt: skip


def prepared(folder, effects):
    """The set-up's fit to recordings of effects that the parameter file does not name."""
    bags = []
    for name, sign in (("left", 1.0), ("right", -1.0)):
        made = read_experiment(turned(sign, effects), name, "turned.yaml")
        synthesize(made, folder / name, images=False, edges=80, step=2e-3)
        bags.append(folder / name)
    tree = copy.deepcopy(CABLE)
    tree["rod"]["young_modulus"] /= 5.0
    flat = {f"{g}.{k}": v for g, block in tree.items() for k, v in block.items()}
    given = searchable(Settings.from_mapping(flat))
    found = begin([load_manipulation(bag, given) for bag in bags], given)
    return prepare(found.recordings, found.at.model.settings, given)


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    """A straight cable."""
    return prepared(tmp_path_factory.mktemp("turning"), WEIGHT)


@pytest.fixture(scope="module")
def crooked(tmp_path_factory):
    """A cable in a crooked grip, so that everything begins far from the shapes."""
    return prepared(tmp_path_factory.mktemp("crooked"), WEIGHT | {"clamp_angle": {"start": 0.06}})


@pytest.mark.slow
@pytest.mark.parametrize("cable", ["turning", "crooked"])
def test_a_heavy_weight_is_found_with_the_stiffness_that_goes_with_it(cable, request):
    turning = request.getfixturevalue(cable)
    alone = turning.setup
    assert alone.mean_err > 2e-3
    found = best_far_start(alone, turning.meant, turning.recordings, starts(turning.scene))
    assert found is not None
    at, proposal = found
    assert proposal.effect in ("point_mass", "connector")
    assert at.mean_err < 0.3 * alone.mean_err
    mass = at.model.settings.effects[proposal.effect]["mass"]
    assert 0.5 * LOAD < mass < 2.0 * LOAD  # the stiffness and the mass nearly trade
    assert 1.5e7 < at.model.settings.rod.young_modulus < 6e7


@pytest.mark.slow
def test_a_heavy_plug_is_one_of_what_explains_it(tmp_path):
    """A mass as far from the end as half the plug explains nearly as much, at other sizes."""
    plugged = prepared(tmp_path, PLUG)
    begun = starts(plugged.scene)
    best = best_far_start(plugged.setup, plugged.meant, plugged.recordings, begun)
    found = [best, *in_its_place(best, plugged.recordings, begun)]
    (plug,) = (at for at, proposal in found if proposal.effect == "connector")
    assert not tells_apart(best[0], plug)
    known = plug.model.settings.effects["connector"]
    assert known["mass"] == pytest.approx(LOAD, rel=0.1)
    assert known["extent"] == pytest.approx(0.1 * LENGTH, rel=0.1)


@pytest.mark.slow
def test_what_a_mass_does_a_plug_as_heavy_does_too(turning):
    """It begins where the fit of the mass has ended, from a place to which no plug's fit came."""
    afar = [s for s in starts(turning.scene) if s.afar]
    masses = [s for s in afar if s.effect == "point_mass"]
    trial = best_far_start(turning.setup, turning.meant, turning.recordings, masses)
    others = in_its_place(trial, turning.recordings, afar)
    assert {proposal.effect for _, proposal in others} == {"connector"}
    assert min(at.mean_err for at, _ in others) < 0.3 * turning.setup.mean_err


def test_nothing_takes_the_place_of_a_mass_beside_which_a_plug_is_known():
    blocks = {
        "point_mass": {"mass": 0.01, "position": 0.2}, "connector": {"mass": 0.02, "extent": 0.04}
    }  # fmt: skip
    heavy = [Start(name, dict(b), (), tuple(b), neutral=False) for name, b in blocks.items()]
    proposals = [proposal_of(PAPER, start) for start in heavy]
    both = with_proposals(ParametricModel(PAPER, ()), proposals)[0]
    assert in_its_place((SimpleNamespace(model=both), proposals[0]), (), heavy) == []


@pytest.mark.slow
def test_a_fit_with_correlated_errors_does_not_leave_the_shapes(turning):
    """From the set-up's fit as if errors were white, whose residual no value of it explains."""
    white = fit(turning.setup, turning.recordings, 12, loss=WHITE)
    found = fit(white, turning.recordings, 12)
    settings = white.model.settings
    immaterial = settings.diagnosis.material_err * settings.rod.length
    assert found.mean_err <= 1.1 * (white.mean_err + immaterial)
    assert misfit(found, white) <= misfit(white, white)
