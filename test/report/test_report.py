# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Reports: whole HTML, no addresses, the numbers in it, and a slider that has its data."""

import json
import math
import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest
from html_check import checked
from rods import PAPER

from dlo_ros.errors import InputError
from dlo_ros.report import (
    EstimateRow,
    IdentificationReport,
    ParameterTrack,
    Photograph,
    RecordingRow,
    ShapeFrame,
    write_identification_report,
)
from dlo_ros.report.elements import (
    grouped_table,
    measured,
    millimetres,
    number,
    table,
    typeset,
)  # fmt: skip
from dlo_ros.report.force import across
from dlo_ros.report.identification import identification_page
from dlo_ros.report.outlines import outlines
from dlo_ros.report.page import write_page
from dlo_ros.report.plots import LinePlot, ReferenceLine, Series, line_plot
from dlo_ros.report.shape_player import MOST_FRAMES, player
from dlo_ros.spline import SplineBasis

LENGTH = 0.4


def arch(height, depth=0.0, n=10):
    """Control points of an arch over the length, height and depth [m]."""
    basis = SplineBasis(n, LENGTH)
    u = basis.greville / LENGTH
    zero = np.zeros(n)
    y = depth * np.sin(2.0 * math.pi * u)
    return np.column_stack([0.3 * u, y, height * np.sin(math.pi * u), zero])


def photograph(t):
    picture = np.full((120, 200, 3), 180, np.uint8)
    line = np.column_stack([np.linspace(20, 180, 30), 60 - 30 * t * np.ones(30)])
    cv2.polylines(picture, [line.astype(np.int32)], False, (40, 40, 40), 4)
    jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
    return Photograph(jpeg, 200, 120, observed=line, predicted=line + 5.0)


def frames(count=5, *, pictures=False, depth=0.0):
    return tuple(
        ShapeFrame(
            time=0.1 * k,
            observed=arch(0.1 + 0.01 * k, depth),
            predicted=arch(0.11 + 0.01 * k, depth),
            err=0.0123 / (k + 1),
            photograph=photograph(0.1 * k) if pictures else None,
        )
        for k in range(count)
    )


def report(**changes):
    times = np.linspace(0.0, 2.0, 50)
    values = 2e4 * (1.0 - 0.8 * np.exp(-3.0 * times))
    tracks = (ParameterTrack("E/mu", "m^2/s^2", times, values, 0.05 * values, 2.0e4),)
    estimates = (
        EstimateRow("Young's modulus E", "Pa", 5.1e7, math.inf, 5e7, False),
        EstimateRow("E/mu", "m^2/s^2", 19876.0, 321.0, 2e4, True),
    )
    recordings = (RecordingRow("c_shape", "train", LENGTH, 0.0312, 0.00142, frames()),)
    content = {
        "title": "Identification of <c_shape>",
        "headline": "ERR 31.2 -> 1.4 mm",
        "estimates": estimates,
        "recordings": recordings,
        "tracks": tracks,
        "noise_floor": 0.0011,
        "remarks": ("A remark with <b> in it.",),
    }
    return IdentificationReport(**(content | changes))


@pytest.fixture
def html(tmp_path):
    write_identification_report(tmp_path / "new" / "report.html", report())
    return (tmp_path / "new" / "report.html").read_text()


def test_it_is_whole_html_with_unique_ids(html):
    checker = checked(html)
    assert len(checker.ids) == len(set(checker.ids))


def test_it_points_nowhere_outside(tmp_path):
    path = tmp_path / "report.html"
    recordings = (RecordingRow("c", "train", LENGTH, None, None, frames(3, pictures=True)),)
    write_identification_report(path, report(recordings=recordings))
    html = path.read_text()
    assert "http" not in html and "//" not in re.sub(r"base64,[\w+/=]+", "", html).replace(
        "// ", ""
    )
    assert all(a.startswith("#") for a in checked(html).addresses)
    for inner in re.findall(r"url\(([^)]*)\)|@import", html):
        assert inner.startswith("#")


def test_every_reference_has_its_target(html):
    targets = set(re.findall(r"url\(#([^)]*)\)", html)) | set(re.findall(r'href="#([^"]*)"', html))
    assert targets and targets <= set(checked(html).ids)


def test_the_numbers_stand_in_it_with_units(html):
    assert "19880 \N{PLUS-MINUS SIGN} 320 m\N{SUPERSCRIPT TWO}/s\N{SUPERSCRIPT TWO}" in html
    assert "5.10\N{MULTIPLICATION SIGN}10\u2077 Pa (std unknown)" in html
    assert "-0.62 %" in html  # 19876 against 2e4
    assert "31.2 mm" in html and "1.42 mm" in html and "0.36 %" in html
    assert "Noise floor: 1.10 mm" in html


def test_what_is_not_identifiable_is_said_in_words(html):
    assert "Young&#x27;s modulus E is not determined by these data" in html
    flags = (EstimateRow("E", "Pa", 1.0, 0.1, identifiable=True),)
    assert "not determined by these data" not in identification_page(report(estimates=flags))


def test_text_is_escaped(html):
    assert "<c_shape>" not in html and "&lt;c_shape&gt;" in html
    assert "<b> in it" not in html


def test_it_needs_neither_frames_nor_tracks():
    bare = RecordingRow("a", "train", LENGTH, None, None)
    html = identification_page(report(recordings=(bare,), tracks=(), noise_floor=None))
    checked(html)
    assert "ERR over time" not in html and 'class="player"' not in html


def test_player_data_are_the_splines():
    checker = checked(player(frames(), LENGTH))
    data = json.loads(checker.scripts[0][1])
    assert len(data["frames"]) == 5 and len(data["views"]) == 1
    assert data["frames"][0]["text"] == "0.00 s, ERR 12.3 mm"
    flat = np.array(data["frames"][4]["curves"][0]["observed"]).reshape(-1, 2)
    basis = SplineBasis(10, LENGTH)
    expected = 1e3 * basis.matrix(np.linspace(0, LENGTH, len(flat))) @ arch(0.14)[:, [0, 2]]
    np.testing.assert_allclose(flat * [1, -1], expected, atol=0.051)
    x, y, width, height = data["views"][0]["box"]
    everything = np.concatenate(
        [np.reshape(c, (-1, 2)) for f in data["frames"] for c in f["curves"][0].values()]
    )
    assert np.all(everything >= [x, y]) and np.all(everything <= [x + width, y + height])


def test_player_shows_photographs_with_their_pixels():
    data = json.loads(checked(player(frames(3, pictures=True), LENGTH)).scripts[0][1])
    assert data["views"][0]["photograph"] and data["views"][0]["box"] == [0, 0, 200, 120]
    assert all(f["photograph"].startswith("data:image/jpeg;base64,") for f in data["frames"])
    assert data["frames"][0]["curves"][0]["observed"][:2] == [20, 60]
    assert len(data["frames"][0]["curves"]) == 2  # photograph and grid


def test_player_looks_from_above_at_shapes_in_space():
    flat = json.loads(checked(player(frames(), LENGTH)).scripts[0][1])
    space = json.loads(checked(player(frames(depth=0.1), LENGTH)).scripts[0][1])
    assert len(flat["views"]) == 1 and len(space["views"]) == 3


def test_player_has_a_view_in_space_that_turns():
    shown = frames(depth=0.1)
    cameras = {"left": np.array([-0.3, -1.2, 0.1]), "near": np.array([0.2, 0.0, 0.03])}
    data = json.loads(checked(player(shown, LENGTH, cameras=cameras)).scripts[0][1])
    view = data["views"][-1]
    assert view["turning"]
    # Every point of every frame is within the box, however it is turned.
    points = [np.reshape(c, (-1, 3)) for f in data["frames"] for c in f["curves"][-1].values()]
    far = np.linalg.norm(np.concatenate(points) - view["centre"], axis=1).max()
    radius = view["box"][3] / 2
    assert radius / 1.2 < far < radius
    # A line of sight points at its camera, and ends there or short of the border.
    left, near = view["rays"]
    sight = 1e3 * cameras["left"] - view["centre"]
    assert np.linalg.norm(left["to"]) == pytest.approx(0.6 * radius, rel=1e-3)
    assert np.dot(left["to"], sight) == pytest.approx(
        np.linalg.norm(left["to"]) * np.linalg.norm(sight), rel=1e-4
    )
    assert near["to"] == pytest.approx(list(1e3 * cameras["near"] - view["centre"]), abs=0.2)
    basis = SplineBasis(shown[0].observed.shape[0], LENGTH)
    first = 1e3 * (basis.matrix(np.array([0.0])) @ shown[0].observed[:, :3])[0]
    assert data["frames"][0]["curves"][-1]["observed"][:3] == pytest.approx(list(first), abs=0.06)


def test_pegs_and_walls_stand_where_they_are():
    effects = {
        "obstacle": {"x": 0.1, "z": -0.05, "radius": 0.01},
        "wall": {"offset": -0.2, "angle": 0.0},
    }
    peg, wall = outlines(PAPER.with_effects(effects))
    centre = np.array([0.1, -0.05])
    np.testing.assert_allclose(np.linalg.norm(peg - centre, axis=1), 0.01)
    np.testing.assert_allclose(peg.mean(axis=0), centre, atol=1e-12)
    assert wall[:, 1].max() == pytest.approx(-0.2) and np.ptp(wall[:, 0]) > 10.0 * LENGTH
    assert outlines(PAPER) == ()
    # The camera shows it elsewhere, as it shows the DLO.
    off = effects | {"camera_scale": {"ratio": 1.25}, "camera_shift": {"x": 0.02, "z": 0.0}}
    shown, _ = outlines(PAPER.with_effects(off))
    np.testing.assert_allclose(shown.mean(axis=0), [0.08 + 0.02, -0.04], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(shown - shown.mean(axis=0), axis=1), 0.008)
    html = player(frames(depth=0.1), LENGTH, bodies=(peg, wall))
    views = json.loads(checked(html).scripts[0][1])["views"]
    drawn = [len(v.get("bodies", ())) for v in views]
    assert drawn == [2, 0, 0]  # they stand upright on the board
    xs, ys = views[0]["bodies"][0][::2], views[0]["bodies"][0][1::2]
    assert (min(xs), max(xs), min(ys), max(ys)) == (90, 110, 40, 60)
    assert "peg or wall" in html and "peg or wall" not in player(frames(), LENGTH)


def test_player_thins_long_recordings_and_keeps_both_ends():
    data = json.loads(checked(player(frames(500), LENGTH)).scripts[0][1])
    assert len(data["frames"]) == MOST_FRAMES
    assert data["frames"][0]["text"].startswith("0.00 s")
    assert data["frames"][-1]["text"].startswith("49.90 s")


def test_player_refuses_what_it_cannot_draw():
    with pytest.raises(InputError, match="at least one frame"):
        player([ShapeFrame(0.0)], LENGTH)
    with pytest.raises(InputError, match="observed spline at 0 s is not finite"):
        player([ShapeFrame(0.0, observed=arch(math.nan))], LENGTH)


def test_plot_follows_the_page_colours():
    x = np.arange(3.0)
    series = Series("a", "observed", x, x + 1, lower=x, upper=x + 2)
    svg = line_plot(
        LinePlot("p", "t [s]", "v [m]", (series,), (ReferenceLine("truth", "true", 1.5),))
    )
    assert "var(--observed)" in svg and "var(--true)" in svg and "var(--ink)" in svg
    assert "#0072b2" not in svg
    for text in ("t [s]", "v [m]", "truth"):
        assert text in svg


def test_a_curve_that_another_one_covers_is_seen_beneath_it():
    x = np.arange(3.0)
    pale = Series("before", "other", x, x + 1.0, wide=True)
    svg = line_plot(LinePlot("p", "t", "v", (pale, Series("after", "predicted", x, x + 1.0))))
    assert re.search(r"stroke: var\(--other\); stroke-opacity: 0.5; stroke-width: 4.5", svg)
    assert svg.index("var(--other)") < svg.index("var(--predicted)")


def test_a_logarithmic_axis_has_numbers_that_people_read():
    x = np.arange(1.0, 4.0)
    for scale, power in ((1.0, False), (1e6, True)):
        curve = Series("a", "observed", x, scale * 10.0**x)
        svg = line_plot(LinePlot("p", "t", "v", (curve,), logarithmic=True))
        assert (">100<" in svg) != power and ("<tspan" in svg) == power


def test_plot_limits_ignore_a_band_without_bounds():
    x = np.arange(1.0, 4.0)
    wide = Series("a", "observed", x, x, lower=x * 1e-20, upper=x * 1e20)
    svg = line_plot(LinePlot("p", "t", "v", (wide,), logarithmic=True))
    assert not re.search(r"10\^\{-?\d\d\}|\N{MINUS SIGN}\d\d", svg)


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (19876.0, 321.0, "19880 +- 320 m"),
        (1.98e7, 3.1e5, "(1.980 +- 0.031)e+07 m"),
        (0.0123, 0.0004, "0.01230 +- 0.00040 m"),
        (12.5, 250.0, "10 +- 250 m"),
        (-0.2, 31.0, "0 +- 31 m"),
        (-0.02, 0.31, "-0.02 +- 0.31 m"),
        (9.65e-4, 1.4143, "0.0 +- 1.4 m"),
        (5e-7, 1e-4, "(0.0 +- 1.0)e-04 m"),
        (0.0, 1e-7, "(0.0 +- 1.0)e-07 m"),
        (0.2, 0.0997, "0.20 +- 0.10 m"),
        (1e6, math.inf, "1.00e+06 m (std unknown)"),
        (1e6, None, "1.00e+06 m (std unknown)"),
        (None, 1.0, "\N{EM DASH}"),
        (math.nan, 1.0, "\N{EM DASH}"),
    ],
)
def test_measured(value, std, text):
    assert measured(value, std, "m") == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 mm"), (0.0312, "31.2 mm"), (1.42e-3, "1.42 mm"), (3e-9, "3.00e-06 mm")],
)
def test_millimetres(value, text):
    assert millimetres(value) == text
    assert number(math.inf, "mm") == "\N{EM DASH}"


def test_as_many_digits_as_wanted_where_rounding_makes_a_number_longer():
    assert [number(v, digits=2) for v in (0.0997, 0.997, 9.97, 99.7)] == [
        "0.10",
        "1.0",
        "10",
        "100",
    ]
    assert number(9.94, digits=2) == "9.9"


@pytest.mark.parametrize(
    ("text", "typeset_text"),
    [
        (
            "(1.980 +- 0.031)e+07 m^2",
            "(1.980 \N{PLUS-MINUS SIGN} 0.031)\N{MULTIPLICATION SIGN}10\u2077 m\u00b2",
        ),
        ("3.0e-06", "3.0\N{MULTIPLICATION SIGN}10\u207b\u2076"),
        ("cable1e-05x", "cable1e-05x"),
    ],
)
def test_powers_are_typeset(text, typeset_text):
    assert typeset(text) == typeset_text


def test_a_single_shape_has_no_slider():
    one, several = player(frames(1), LENGTH), player(frames(3), LENGTH, first=0.0)
    assert '<button type="button" hidden>' in one and 'aria-label="time" hidden' in one
    assert '<button type="button">' in several and 'max="2" value="0"' in several


def test_a_slender_shape_leaves_room_for_the_labels():
    tall = np.array([[0.0, 0.0, -z] for z in np.linspace(0.0, LENGTH, 8)])
    (view,) = json.loads(checked(player([ShapeFrame(0.0, observed=tall)], LENGTH)).scripts[0][1])[
        "views"
    ]
    _, _, width, height = view["box"]
    assert width == pytest.approx(4.0 / 3.0 * height, rel=1e-2)


def test_the_force_across_leaves_out_what_is_along():
    u = np.linspace(0.0, LENGTH, 5)
    straight = np.zeros((2, 8, 3))
    straight[:, :, 0] = np.linspace(0.0, LENGTH, 8)
    force = np.broadcast_to([7.0, 0.0, -2.0], (2, 5, 3))
    left, std = across(straight, LENGTH, u, force, np.full((2, 5, 3), 0.5))
    np.testing.assert_allclose(left, np.broadcast_to([0.0, 0.0, -2.0], (2, 5, 3)), atol=1e-12)
    np.testing.assert_allclose(std, np.broadcast_to([0.0, 0.5, 0.5], (2, 5, 3)), atol=1e-12)


def test_rows_of_a_table_stand_below_the_title_of_their_group():
    html = grouped_table(["a", "b"], [("one & two", [["x", "1"]]), ("three", [["y", "2"]])])
    checked(html)
    assert html.count("<tbody>") == 2 and '>one &amp; two</th></tr><tr><th scope="row">x' in html
    assert '<th scope="rowgroup" colspan="2">three</th>' in html


def test_table_marks_its_heads():
    html = table(["a", "b"], [["x & y", "1"]])
    checked(html)
    assert '<th scope="row">x &amp; y</th><td>1</td>' in html


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "report.html"
    write_page(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_page(path, "new \udc80")
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium to draw the page with")
def test_a_browser_draws_the_last_frame(tmp_path):
    path = tmp_path / "report.html"
    recordings = (RecordingRow("c", "train", LENGTH, None, None, frames(3, pictures=True)),)
    write_identification_report(path, report(recordings=recordings))
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/u"]
    done = subprocess.run(
        [CHROMIUM, *options, "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "0.20 s, ERR 4.10 mm</output>" in done.stdout
    assert len(re.findall(r'class="curve observed" d="M', done.stdout)) >= 3
