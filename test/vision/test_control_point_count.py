# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""The number of control points: what a spline says of points that it was not fitted to."""

import re
from dataclasses import replace

import numpy as np
import pytest
from picture_bags import write_bag
from scipy.spatial.transform import Rotation
from vision_scenes import LENGTH, Scene, bow, clamps, loop, render, settings

from dlo_ros.cli import main as cli
from dlo_ros.cli.control_points import with_control_points
from dlo_ros.cli.observe import observe_recording
from dlo_ros.errors import VisionError
from dlo_ros.observation import CentrelinePoints
from dlo_ros.parameters import Settings
from dlo_ros.recordings import read_recording
from dlo_ros.spline import SplineBasis
from dlo_ros.vision import Observer
from dlo_ros.vision.fit.control_point_count import (
    choose_control_points,
    enough_control_points,
    follows,
    misfit,
)


def points_of(control_points, noise, seed=0, count=150):
    """Points of a random spline, with noise across and along [m]."""
    rng = np.random.default_rng(seed)
    basis = SplineBasis(control_points, LENGTH)
    straight = np.column_stack([basis.greville, np.zeros(control_points)])
    q = straight + rng.normal(0.0, 0.012, straight.shape)
    u = np.linspace(0.0, LENGTH, count)
    xz = basis.matrix(u) @ q + rng.normal(0.0, noise, (count, 2))
    positions = np.column_stack([xz[:, 0], np.zeros(count), xz[:, 1]])
    return CentrelinePoints(positions, u, np.full(count, noise))


@pytest.mark.parametrize("true", [6, 10, 14])
def test_what_the_shape_needs_is_found(true):
    chosen = [choose_control_points(points_of(true, 2e-5, seed), LENGTH) for seed in range(5)]
    # A number that is no multiple of the true spans needs some more to follow it as well.
    assert all(true - 1 <= n <= 4 * true for n in chosen)


def test_a_shape_needs_as_many_whichever_way_it_lies_in_space():
    points = points_of(14, 1e-4, count=300)
    lifted = points.positions + np.random.default_rng(1).normal(0.0, 1e-4, (300, 3))
    chosen = []
    for axis in ([1.0, 0.0, 0.0], [2.0, 1.0, -1.0], [0.0, 0.0, 1.0]):
        turned = Rotation.from_rotvec(0.5 * np.pi * np.array(axis)).apply(lifted)
        chosen.append(choose_control_points(replace(points, positions=turned), LENGTH))
    level = choose_control_points(points, LENGTH)
    assert chosen == [chosen[0]] * 3
    assert 13 <= chosen[0] <= level + 3


def test_noise_asks_for_fewer():
    clean = choose_control_points(points_of(14, 1e-5), LENGTH)
    noisy = choose_control_points(points_of(14, 3e-3), LENGTH)
    assert noisy < clean


def test_single_wrong_points_do_not_choose():
    points = points_of(8, 2e-5)
    points.positions[[20, 71, 118], 2] += 0.004
    assert (
        choose_control_points(points, LENGTH)
        <= choose_control_points(points_of(8, 2e-5), LENGTH) + 8
    )


def test_too_few_points_are_refused():
    with pytest.raises(VisionError, match="too few"):
        choose_control_points(points_of(6, 1e-5, count=12), LENGTH)


def test_a_spline_that_cannot_follow_names_a_number_that_can():
    scene, xz = Scene(), loop()
    with pytest.raises(VisionError, match=r"more control points are needed \(\d+ would do\)"):
        Observer(settings(scene, 4), scene.camera(), clamps(xz, 4)).observe(0, render(xz, scene))


def test_whether_a_spline_follows_is_told_by_the_points():
    points = points_of(12, 2e-5)
    splines = {
        n: SplineBasis(n, LENGTH).fit(points.u, points.positions, np.ones(150)) for n in (6, 12)
    }
    assert follows(points, splines[12], LENGTH)
    assert not follows(points, splines[6], LENGTH)
    assert misfit(points, splines[6], LENGTH) > 1e-3 > misfit(points, splines[12], LENGTH)
    enough = enough_control_points(points, LENGTH)
    assert 10 <= enough <= 20
    basis = SplineBasis(enough, LENGTH)
    assert follows(points, basis.fit(points.u, points.positions), LENGTH)
    # Where the points scatter more than it misses them, there is nothing to follow.
    assert follows(replace(points, std=np.full(150, 0.02)), splines[6], LENGTH)
    # No spline follows points that jump about.
    wild = replace(points, positions=points.positions + np.resize([0.0, 0.01], (150, 3)))
    with pytest.raises(VisionError, match="no spline"):
        enough_control_points(wild, LENGTH)


def test_observe_says_when_the_control_points_are_too_few(tmp_path, capsys):
    scene, xz = Scene(), bow()
    for n, few in ((7, True), (20, False)):
        bag = tmp_path / f"bag{n}"
        write_bag(bag, scene, [render(xz, scene)] * 2, clamps(xz, n).commands[0])
        settings(scene, n).dump(tmp_path / "params.yaml")
        words = ["observe", "--params", str(tmp_path / "params.yaml"), "--output"]
        assert cli.main([*words, str(tmp_path / f"out{n}"), str(bag)]) == 0
        said = capsys.readouterr().out
        assert ("in 2 a spline of 7 control points cannot follow the DLO" in said) == few
        assert ("would do" in said) == few


@pytest.mark.parametrize(("wanted", "least", "most"), [("auto", 12, 40), ("17", 17, 17)])
def test_observe_with_another_number(tmp_path, capsys, wanted, least, most):
    scene, xz = Scene(), bow()
    write_bag(tmp_path / "bag", scene, [render(xz, scene)] * 2, clamps(xz).commands[0])
    known = settings(scene, 6)
    known.dump(tmp_path / "params.yaml")
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--control-points", wanted]
    assert cli.main([*words, "--output", str(tmp_path / "out"), str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    n = int(said.split()[0]) if wanted == "auto" else 17
    assert least <= n <= most
    more = replace(known, rod=replace(known.rod, control_points=n))
    (first, _) = read_recording(tmp_path / "out", more).observations
    assert len(first.control_points) == n


def test_observe_refuses_what_is_no_number(tmp_path, capsys):
    scene = Scene()
    write_bag(tmp_path / "bag", scene, [render(bow(), scene)])
    settings(scene).dump(tmp_path / "params.yaml")
    words = ["observe", "--params", str(tmp_path / "params.yaml"), "--control-points", "many"]
    assert cli.main([*words, "--output", str(tmp_path / "out"), str(tmp_path / "bag")]) == 2
    assert "rod.control_points is 'many'" in capsys.readouterr().err


def without_number(path, known):
    """The parameter file of settings that does not say how many control points there are."""
    lines = [line for line in known.text().splitlines() if "control_points" not in line]
    path.write_text("\n".join(lines) + "\n")
    assert Settings.load(path).rod.control_points == 10


def test_where_the_file_has_no_number_the_images_choose_it(tmp_path, capsys):
    scene, xz = Scene(), bow()
    params = tmp_path / "params.yaml"
    without_number(params, settings(scene, 6))
    write_bag(tmp_path / "bag", scene, [render(xz, scene)] * 2, clamps(xz).commands[0])
    words = ["observe", "--params", str(params), "--output"]
    assert cli.main([*words, str(tmp_path / "out"), str(tmp_path / "bag")]) == 0
    found = re.search(r"(\d+) control points by cross-validation", capsys.readouterr().out)
    n = int(found[1])
    assert 11 <= n <= 40
    # The other tools take the number of what was observed.
    known = Settings.load(params)
    taken = with_control_points(known, params, [tmp_path / "out"], observe_recording)
    assert taken.rod.control_points == n
    (first, _) = read_recording(tmp_path / "out", taken).observations
    assert len(first.control_points) == n
    # A number that is given stays, as does the default where no bag tells.
    settings(scene, 7).dump(tmp_path / "given.yaml")
    given = Settings.load(tmp_path / "given.yaml")
    bags = [tmp_path / "nothing", tmp_path / "out"]
    assert with_control_points(given, tmp_path / "given.yaml", bags, observe_recording) == given
    assert with_control_points(known, params, bags[:1], observe_recording) == known


def test_a_command_that_names_control_points_keeps_their_number(tmp_path):
    scene, xz = Scene(), bow()
    params = tmp_path / "params.yaml"
    without_number(params, settings(scene, 10))
    held = replace(clamps(xz, 10).commands[0], names=("start", "control_point_10"))
    write_bag(tmp_path / "bag", scene, [render(xz, scene)], held)
    known = Settings.load(params)
    assert with_control_points(known, params, [tmp_path / "bag"], observe_recording) == known


def test_commands_that_count_control_points_are_told_where_another_number_would_do(
    tmp_path, capsys
):
    scene, xz = Scene(), bow()
    held = replace(clamps(xz, 7).commands[0], names=("start", "control_point_7"))
    write_bag(tmp_path / "bag", scene, [render(xz, scene)], held)
    settings(scene, 7).dump(tmp_path / "params.yaml")
    words = ["observe", "--params", str(tmp_path / "params.yaml"), str(tmp_path / "bag")]
    words += ["--output", str(tmp_path / "out")]
    assert cli.main(words) == 0
    assert (
        "would do (not with these commands, which name control_point_7" in capsys.readouterr().out
    )
    # Followed, the number would make a pin of the end.
    assert cli.main([*words, "--control-points", "auto", "--force"]) == 2
    assert "names control_point_7, which is another place" in capsys.readouterr().err


def test_images_without_a_dlo_leave_the_default(tmp_path, capsys):
    scene = Scene()
    params = tmp_path / "params.yaml"
    without_number(params, settings(scene))
    write_bag(tmp_path / "bag", scene, [np.full((540, 960, 3), 200, np.uint8)])
    words = ["observe", "--params", str(params), "--output"]
    assert cli.main([*words, str(tmp_path / "out"), str(tmp_path / "bag")]) == 2
    assert "no image shows a credible DLO" in capsys.readouterr().err
