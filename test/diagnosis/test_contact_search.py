# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Where a DLO may have hit a peg: by geometry, and in a recording of the discrete rod."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from challenge.generate import draw
from field import generate, spatial
from rods import PAPER

from dlo_ros.cli.loading import load_manipulation
from dlo_ros.diagnosis.contact import contact_search, undisturbed
from dlo_ros.diagnosis.contact.contact_search import contacts_beside_set_up, plausible_pegs
from dlo_ros.diagnosis.contact.peg_places import (
    STATIONS,
    Place,
    Sight,
    TouchedPeg,
    apart,
    places,
    sight,
)  # fmt: skip
from dlo_ros.diagnosis.contact.wall_places import TouchedWall
from dlo_ros.effects import Start
from dlo_ros.identification.offline.drafts import drafts
from dlo_ros.identification.offline.initial_fit import begin
from dlo_ros.identification.residual_noise import whitened
from dlo_ros.inference.joint import simulate
from dlo_ros.inference.priors import cause_priors, joint_model
from dlo_ros.inference.scene import imposed_names, scene
from dlo_ros.inference.thresholds import UNEXPLAINED_PICTURES
from dlo_ros.parameters import Settings
from dlo_ros.rod.measured_shapes import MeasurementMap
from dlo_ros.spline import SplineBasis

ROD = PAPER.rod
DROP = 0.004
"""Of the straight rope in the pictures below, from one to the next [m]."""
TOP = -0.05
HIT = int(-TOP / DROP) + 1


def falling(frames=30, rod=ROD):
    """A level rope that falls and is caught in its middle, and where it would be otherwise."""
    basis = SplineBasis(rod.control_points, rod.length)
    u = np.linspace(0.0, rod.length, 200)
    values = basis.matrix(u)
    expected, seen = [], []
    for k in range(frames):
        points = np.zeros((len(u), 3))
        points[:, 0], points[:, 2] = u, -DROP * k
        expected.append(np.linalg.lstsq(values, points, rcond=None)[0])
        hump = max(TOP + DROP * k, 0.0) * np.exp(-(((u / rod.length - 0.5) / 0.2) ** 2))
        points[:, 2] += hump
        seen.append(np.linalg.lstsq(values, points, rcond=None)[0])
    return np.array(seen), np.array(expected)


def test_a_peg_stands_where_the_rope_is_caught():
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    view = sight(PAPER, [seen], [expected], [wrong])
    radius = 0.01
    best = places(view, radius)[0]
    assert view.count == np.count_nonzero(wrong) > 10
    assert best.left <= 1
    assert best.touched >= view.count - 1
    assert best.peg.x == pytest.approx(0.5 * ROD.length, abs=0.05 * ROD.length)
    assert best.peg.z + radius + 0.5 * ROD.diameter == pytest.approx(TOP, abs=3e-3)
    first, *others = apart([p.peg for p in places(view, radius)], 0.05, 5)
    assert first == best.peg
    assert all(np.hypot(o.x - best.peg.x, o.z - best.peg.z) > 0.05 for o in others)
    start, *_ = plausible_pegs(view)
    assert start.block["x"] == pytest.approx(0.5 * ROD.length, abs=0.1 * ROD.length)


def test_a_peg_that_no_picture_shows_touched_may_stand_anywhere_on_the_way_between_two():
    """A level rope falls fast, and its middle bounces off a peg between two pictures."""
    u, drop, touched, radius = np.linspace(0.04, 1.0, STATIONS) * ROD.length, 0.03, -0.135, 0.01
    expected = np.empty((8, STATIONS, 2))
    expected[..., 0], expected[..., 1] = u, -drop * np.arange(8)[:, None]
    seen = expected.copy()
    up = 2.0 * np.maximum(touched - expected[..., 1], 0.0)
    seen[..., 1] += up * np.exp(-(((u / ROD.length - 0.5) / 0.2) ** 2))
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    found = places(Sight(ROD, (seen,), (expected,), (wrong,)), radius)
    top = touched - 0.5 * ROD.diameter
    nearest = min(found, key=lambda p: np.hypot(p.peg.x - 0.5 * ROD.length, p.peg.z + radius - top))
    assert nearest.peg[:2] == pytest.approx((0.5 * ROD.length, top - radius), abs=drop / 6)
    assert (nearest.left, nearest.met) == (0, np.count_nonzero(wrong))


def test_a_peg_stands_on_the_board_and_not_where_a_camera_that_is_off_shows_it():
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    off = {
        "camera_scale": {"ratio": 1.07},
        "camera_rotation": {"angle": 0.1},
        "camera_shift": {"x": 0.02, "z": -0.03},
    }
    there = PAPER.with_effects(off)
    camera = MeasurementMap(there)
    shown = [camera.measured(shapes) for shapes in (seen, expected)]
    assert np.abs(shown[0] - seen).max() > 0.03
    view, as_shown = (
        sight(there, shown[:1], shown[1:], [wrong]),
        sight(PAPER, *[[s] for s in shown], [wrong]),
    )
    true = sight(PAPER, [seen], [expected], [wrong])
    np.testing.assert_allclose(view.seen[0], true.seen[0], atol=1e-12)
    np.testing.assert_allclose(view.expected[0], true.expected[0], atol=1e-12)
    x, z, _ = places(view, 0.01)[0].peg
    assert x == pytest.approx(0.5 * ROD.length, abs=0.05 * ROD.length)
    assert z + 0.01 + 0.5 * ROD.diameter == pytest.approx(TOP, abs=3e-3)
    assert places(as_shown, 0.01)[0].peg.z < z - 0.01


def test_what_is_wrong_in_another_recording_hides_no_peg():
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    # The other one goes astray to the side, far from where the peg stands.
    away, astray = expected.copy(), np.ones(len(seen), dtype=np.bool_)
    away[:, :, 0] += 2.0 * ROD.length
    view = sight(PAPER, [seen, 1.1 * away], [expected, away], [wrong, astray])
    best = places(view, 0.01)[0]
    assert best.left >= len(astray) > UNEXPLAINED_PICTURES * view.count
    assert best.met == np.count_nonzero(wrong)
    start, *_ = plausible_pegs(view)
    assert start.block["x"] == pytest.approx(0.5 * ROD.length, abs=0.1 * ROD.length)


def test_pegs_that_explain_less_are_simulated_beside_those_that_seem_to_explain_all(monkeypatch):
    # One recording is wrong for another reason, and the other one from early on.
    near_both, late, near_one, off = (TouchedPeg(x, -0.1, 0.01) for x in (0.1, 0.2, 0.3, 0.5))
    found = [
        Place(near_both, left=0, met=20, touched=1),
        Place(late, left=5, met=20, touched=1),
        Place(near_one, left=8, met=12, touched=9),
        Place(off, left=20, met=0, touched=0),
    ]
    monkeypatch.setattr(contact_search, "places", lambda *_: found)
    view = Sight(ROD, (), (), (np.ones(8, dtype=np.bool_), np.ones(12, dtype=np.bool_)))
    left = {near_both: 30.0, late: 1.0, near_one: 2.0}
    hit = SimpleNamespace(view=view, given=PAPER, losses=lambda some: [(left[p], p) for p in some])
    assert contact_search._best_pegs(hit) == [(1.0, late), (2.0, near_one), (30.0, near_both)]


def test_nothing_stands_where_a_dlo_has_been():
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    caught, fallen = (sight(PAPER, [x], [expected], [wrong]) for x in (seen, expected))
    touched = TOP - 0.5 * ROD.diameter
    x, radius = 0.5 * ROD.length, 0.01
    peg = TouchedPeg(x, touched - radius, radius)
    assert not peg.is_entered(caught)
    assert peg.is_entered(fallen)
    assert TouchedPeg(x, touched, radius).is_entered(caught)
    table = TouchedWall(x, float(seen[-1, :, 2].min()), 0.0)
    assert not table.is_entered(caught)
    assert table._replace(z=TOP).is_entered(caught)
    hit = PAPER.with_effects({"obstacle": peg._asdict(), "wall": {"offset": touched, "angle": 0.0}})
    assert peg.fitted(hit) == pytest.approx(peg)
    assert table.fitted(hit) == pytest.approx((0.0, TOP, 0.0))


def test_a_fit_that_leads_a_peg_to_where_a_dlo_has_been_is_not_taken(monkeypatch):
    """The recording in which it was hit does not tell that a larger one bars another's way."""
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    view = sight(PAPER, [seen], [expected], [wrong])
    peg = places(view, 0.01)[0].peg
    hit = contact_search._Disturbed(PAPER, (), 1.0, PAPER, view)
    monkeypatch.setattr(contact_search._Disturbed, "loss", lambda *_: 1.0)
    ways = []

    def evaluated(model, _):
        return SimpleNamespace(model=model, fields=[(np.array([2.0]), None)])

    def led(at, *_, **__):
        moved = dict(at.model.settings.effects["obstacle"])
        moved["z"] += ways[-1]
        there = SimpleNamespace(settings=at.model.settings.with_effects({"obstacle": moved}))
        return SimpleNamespace(model=there, fields=[(np.array([1.0]), None)])

    monkeypatch.setattr(contact_search, "evaluate", evaluated)
    monkeypatch.setattr(contact_search, "fit", led)
    found = {}
    for way in (-0.001, 0.03):
        ways.append(way)
        found[way] = hit.fitted(peg, 1.0)
    assert hit.fitted(peg, 0.9) is None
    assert found[-0.001][0] == 1.0 and found[0.03][0] == 4.0
    assert found[0.03][1].block["z"] == pytest.approx(found[-0.001][1].block["z"] + 0.001)


def test_what_another_recording_sweeps_holds_no_peg():
    seen, expected = falling()
    wrong = np.abs(seen - expected).max(axis=(1, 2)) > 1e-3
    free = np.zeros(len(seen), dtype=np.bool_)
    view = sight(PAPER, [seen, expected], [expected, expected], [wrong, free])
    assert places(view, 0.01) == []
    assert plausible_pegs(view) == []


@pytest.mark.slow
def test_a_hidden_wall_beside_which_the_rope_bounces_is_found(tmp_path):
    """No picture shows the rope at the wall, and no start of the search lies near it."""
    challenge = draw(8130, "single", ("wall",))
    bags = challenge.write(tmp_path, edges=100, step=2e-3)
    settings = Settings.load(tmp_path / "params.yaml")
    beginning = begin([load_manipulation(bag, settings) for bag in bags], settings)
    begun = next(c for c in looked_for(settings, beginning) if c.start.effect == "wall")
    model = begun.before.extended("wall", begun.start.block, ())
    there = simulate(model, beginning.recordings, ())
    plain = beginning.at
    hit = int(np.argmax([e.mean() for e in plain.err]))
    assert there.err[hit].mean() < 0.15 * plain.err[hit].mean()


@pytest.mark.parametrize("entered", [0.0, 0.5, 1.0])
def test_a_thick_rope_may_be_seen_to_pass_a_peg_by_its_radius(entered):
    """A falling rope is held up by a peg and seen with its axis too deep, by some radii."""
    rod = replace(ROD, diameter=0.01)
    radius, thickness, centre = 0.012, 0.005, np.array([0.25, -0.05])
    u = np.linspace(0.04, 1.0, STATIONS) * rod.length
    expected = np.empty((40, STATIONS, 2))
    expected[:, :, 0] = u
    expected[:, :, 1] = -1.6 * DROP * np.arange(40)[:, None] * u / rod.length
    lying = radius + (1.0 - entered) * thickness  # seen distance of the axis from the centre
    half = np.sqrt(np.maximum(lying**2 - (u - centre[0]) ** 2, 0.0))
    above = np.where(half > 0.0, centre[1] + half, -np.inf)
    seen = expected.copy()
    seen[:, :, 1] = np.maximum(expected[:, :, 1], above)
    met = np.flatnonzero((np.linalg.norm(expected - centre, axis=2) < lying).any(axis=1))[0]
    seen[:met], wrong = expected[:met], np.arange(40) >= met
    found = places(Sight(rod, (seen,), (expected,), (wrong,)), radius)
    assert found
    nearest = min(np.hypot(p.peg.x - centre[0], p.peg.z - centre[1]) for p in found)
    assert nearest < entered * thickness + 1e-3


def test_what_goes_astray_without_meeting_anything_is_no_peg():
    seen, expected = falling()
    # Off from the beginning, long before the rope is where the peg would be.
    wrong = np.ones(len(seen), dtype=np.bool_)
    assert places(sight(PAPER, [seen], [expected], [wrong]), 0.01)[0].left >= HIT - 1
    assert plausible_pegs(sight(PAPER, [seen], [expected], [wrong])) == []


def test_a_picture_is_disturbed_that_deviates_clearly_more_than_those_fitted(monkeypatch):
    """A tip slides on a table, and what it does grows to eighty times of what is left before."""
    right, sliding = np.ones(30), np.linspace(1.0, 80.0, 40)
    whole = SimpleNamespace(times=np.arange(71) / 30.0, until=lambda stop: f"until {stop}")
    model = SimpleNamespace(model="fitted")
    monkeypatch.setattr(undisturbed.joint, "evaluate", lambda *_: model)
    monkeypatch.setattr(undisturbed.joint_fit, "settled", lambda *_: model)
    monkeypatch.setattr(undisturbed.joint, "simulate", lambda _, recordings, __: recordings)
    each = {True: right, False: np.concatenate([right, sliding**2])}
    monkeypatch.setattr(undisturbed, "_squares", lambda at, _: [each[at == ["until 31"]]])
    found = undisturbed._fitted([whole], model, [31])
    assert found.scale == pytest.approx(3.0)
    each[False] = np.ones(70)
    assert undisturbed._fitted([whole], model, [31]) is None


@pytest.fixture(scope="module")
def hidden(tmp_path_factory):
    """Two recordings of the discrete rod with a hidden peg, and the plain fit."""
    folder = tmp_path_factory.mktemp("peg")
    bags = draw(7106, "single", ("obstacle",)).write(folder, edges=100, step=2e-3)
    settings = Settings.load(folder / "params.yaml")
    beginning = begin([load_manipulation(bag, settings) for bag in bags], settings)
    peg = json.loads((folder / "challenge.json").read_text())["effects"]["obstacle"]
    return settings, beginning, peg


def looked_for(settings, beginning):
    """Pegs and walls that may have been hit, beside the set-up."""
    rough = drafts(beginning.recordings, beginning.at)
    names = imposed_names(d.manipulation for d in rough)
    here = scene(settings, names, [d.observed for d in rough])
    return contacts_beside_set_up(
        rough, settings, joint_model(beginning.at.model.settings, settings, here)
    )


@pytest.mark.slow
def test_a_hidden_peg_is_found_where_it_stands(hidden):
    settings, beginning, peg = hidden
    at = beginning.at
    begun = looked_for(settings, beginning)[0]
    block = begun.start.block
    assert begun.start.effect == "obstacle" and not begun.start.neutral
    # The rope touches it on one side: its near edge is known best.
    gap = np.hypot(block["x"] - peg["x"], block["z"] - peg["z"])
    assert gap < abs(block["radius"] - peg["radius"]) + 0.006
    there = simulate(begun.before.extended("obstacle", block, ()), beginning.recordings, ())
    before, after = (
        np.mean([np.mean(r[1:] * r[:-1]) for r in whitened(e, beginning.recordings)])
        for e in (at, there)
    )  # fmt: skip
    assert before > 100.0 and after < 0.01 * before
    known = replace(at, model=at.model.extended("obstacle", peg, ()))
    assert looked_for(settings, replace(beginning, at=known)) == []


@pytest.mark.slow
@pytest.mark.long
def test_a_hidden_wall_in_space_is_found(tmp_path):
    """Along the wall the rope moves as it does in free space."""
    spatial.draw(9774, 1, own_rope=True).write(tmp_path)
    settings = Settings.load(tmp_path / "params.yaml")
    bags = sorted(p for p in tmp_path.iterdir() if p.is_dir())
    beginning = begin([load_manipulation(bag, settings) for bag in bags], settings)
    wall = json.loads((tmp_path / "case.json").read_text())["causes"]["wall"]
    begun = looked_for(settings, beginning)[0]
    assert begun.start.effect == "wall"
    assert begun.start.block["angle"] == pytest.approx(wall["angle"], abs=0.3)
    free = simulate(begun.before, beginning.recordings, ())
    hit = begun.before.extended("wall", begun.start.block, ())
    assert simulate(hit, beginning.recordings, ()).mean_err < 0.7 * free.mean_err


@pytest.mark.slow
@pytest.mark.long
def test_a_wall_is_found_off_which_an_unknown_soft_part_has_the_rope_rebound_otherwise(tmp_path):
    """In all pictures after the hit the simulation is farther off with the wall than without."""
    generate.draw(4986, 2, own_rope=True).write(tmp_path)
    settings = Settings.load(tmp_path / "params.yaml")
    bags = sorted(p for p in tmp_path.iterdir() if p.is_dir())
    beginning = begin([load_manipulation(bag, settings) for bag in bags], settings)
    causes = json.loads((tmp_path / "case.json").read_text())["causes"]
    assert set(causes) == {"wall", "stiff_segment"}
    walls = [b.start.block for b in looked_for(settings, beginning) if b.start.effect == "wall"]
    assert walls
    assert walls[0]["offset"] == pytest.approx(causes["wall"]["offset"], abs=0.01)
    assert walls[0]["angle"] == pytest.approx(causes["wall"]["angle"], abs=0.1)


@pytest.mark.slow
@pytest.mark.long
def test_a_peg_that_does_not_help_is_none(hidden, monkeypatch):
    settings, beginning, _ = hidden
    monkeypatch.setattr(contact_search._Disturbed, "loss", lambda *_: 1e9)
    assert looked_for(settings, beginning) == []


@pytest.mark.slow
@pytest.mark.long
def test_where_a_peg_is_not_touched_its_place_does_not_matter(hidden):
    settings, beginning, peg = hidden
    parameters, _ = cause_priors(settings, Start("obstacle", peg, (), tuple(peg), neutral=False))
    model = beginning.at.model.extended("obstacle", peg, parameters)
    jacobians = [j for _, j in simulate(model, beginning.recordings).fields]
    columns = [model.index(f"effects.obstacle.{key}") for key in peg]
    sizes = [np.abs(j[:, columns]).max() for j in jacobians]
    own = [np.abs(j[:, 0]).max() for j in jacobians]
    assert min(sizes) == 0.0 < max(sizes)
    assert min(own) > 0.0
