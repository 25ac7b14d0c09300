# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Every report as a person's browser shows it: no error, no network, and a slider that moves."""

import json
import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest
from calibration_scenes import chessboard, poses, usual_lens
from diagnoses import KNOWN, found
from measured import swing
from rods import PAPER
from tool_runs import run, write_bag

from dlo_ros.cli.diagnosis_output import write_results
from dlo_ros.report.page import Section, page, write_page
from dlo_ros.report.shape_player import ShapeFrame, player
from dlo_ros.vision.calibration.patterns import parse_pattern

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(BROWSER is None, reason=f"none of {', '.join(BROWSERS)} is on PATH"),
]

# Before the page's own scripts: what goes wrong, and what is asked for from elsewhere.
EARS = """<script>
window.heard = {errors: [], asked: []};
addEventListener("error", e => heard.errors.push(String(e.message || e.target.outerHTML)), true);
addEventListener("unhandledrejection", e => heard.errors.push(String(e.reason)));
for (const level of ["error", "warn"]) {
  const before = console[level];
  console[level] = (...words) => { heard.errors.push(words.join(" ")); before(...words); };
}
for (const name of ["fetch", "XMLHttpRequest", "WebSocket"]) {
  window[name] = function (what) { heard.asked.push(name + " " + what); };
}
</script>"""

# After them: every slider is moved from one end to the other, every button is pressed.
HAND = """<script>
addEventListener("load", () => {
  const players = [...document.querySelectorAll(".player")].map(player => {
    const slider = player.querySelector("input[type=range]");
    const seen = [slider.min, slider.max].map(value => {
      slider.value = value;
      slider.dispatchEvent(new Event("input", {bubbles: true}));
      const curves = [...player.querySelectorAll(".views .curve")].map(c => c.getAttribute("d"));
      const arrows = [...player.querySelectorAll(".views .arrow.arrows")].map(
        c => c.getAttribute("d"));
      return {curves, arrows, text: player.querySelector("output").textContent,
              pictures: [...player.querySelectorAll("image")].map(i => i.getAttribute("href"))};
    });
    const turns = [...player.querySelectorAll("svg.turning")].map(svg => {
      const drawn = () => [...svg.querySelectorAll(".curve")].map(c => c.getAttribute("d")).join();
      const at = (kind, x, y) => svg.dispatchEvent(
        new PointerEvent(kind, {clientX: x, clientY: y, bubbles: true}));
      const key = name => svg.dispatchEvent(new KeyboardEvent("keydown", {key: name}));
      const before = drawn();
      at("pointermove", 40, 10); const idle = drawn();
      at("pointerdown", 0, 0); at("pointermove", 40, 10); at("pointerup", 40, 10);
      const dragged = drawn();
      at("pointermove", 0, 0); const released = drawn();
      key("ArrowLeft"); const keyed = drawn();
      return {before, idle, dragged, released, keyed};
    });
    const button = player.querySelector("button");
    button.click(); const playing = button.textContent; button.click();
    return {seen, turns, steps: Number(slider.max) + 1, playing, stopped: button.textContent};
  });
  heard.players = players;
  heard.loaded = performance.getEntriesByType("resource").map(e => e.name);
  heard.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  heard.svgs = document.querySelectorAll("svg").length;
  const told = document.createElement("script");
  told.type = "application/json"; told.id = "heard"; told.textContent = JSON.stringify(heard);
  document.body.append(told);
});
</script>"""


def opened(report, tmp_path):
    """What a browser without any network hears when it opens a report."""
    html = report.read_text()
    assert html.count("<head>") == 1 and html.count("</body>") == 1
    probed = tmp_path / "probed.html"
    probed.write_text(html.replace("<head>", "<head>" + EARS).replace("</body>", HAND + "</body>"))
    options = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--window-size=1100,1600", "--virtual-time-budget=4000",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path}/profile",
    ]  # fmt: skip
    done = subprocess.run(
        [BROWSER, *options, "--dump-dom", probed.as_uri()],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    told = re.search(r'id="heard">(.*?)</script>', done.stdout, re.DOTALL)
    assert told, done.stderr[-2000:]
    heard = json.loads(told.group(1))
    picture = tmp_path / "report.png"
    subprocess.run(
        [BROWSER, *options, f"--screenshot={picture}", report.as_uri()],
        capture_output=True, timeout=120, check=False,
    )  # fmt: skip
    heard["picture"] = cv2.imread(str(picture))
    return heard


def check(heard):
    assert heard["errors"] == []
    assert heard["asked"] == []
    assert [name for name in heard["loaded"] if not name.startswith("data:")] == []
    assert heard["wide"] <= 0  # nothing has to be scrolled sideways
    assert heard["svgs"] > 0
    # Something is drawn, in more than a few colours.
    picture = heard["picture"]
    assert picture is not None
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def check_players(heard, at_least=1):
    assert len(heard["players"]) >= at_least
    for shown in heard["players"]:
        first, last = shown["seen"]
        assert shown["steps"] > 1
        assert first["curves"] and all(d.startswith("M") for d in first["curves"])
        assert first["curves"] != last["curves"]
        assert first["text"] != last["text"]
        assert shown["playing"] != shown["stopped"]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings")
    for seed, name in enumerate(("one", "two")):
        write_bag(path / name, swing(PAPER, seconds=0.7, seed=seed))
    PAPER.with_material(1e7, 2000.0).dump(path / "params.yaml")
    return path


def test_identify(recordings, tmp_path):
    words = ["--params", recordings / "params.yaml", "--output", tmp_path / "out"]
    assert run("identify", *words, "--validate", recordings / "two", recordings / "one") == 0
    heard = opened(tmp_path / "out" / "report.html", tmp_path)
    check(heard)
    check_players(heard, at_least=2)


def test_design(recordings, tmp_path):
    words = ["--params", recordings / "params.yaml", "--output", tmp_path / "out"]
    assert run("design", *words, "--tries", "4", "simple", "c_shape") == 0
    check(opened(tmp_path / "out" / "report.html", tmp_path))


def test_diagnose(tmp_path):
    write_results(tmp_path / "out", KNOWN, found())
    heard = opened(tmp_path / "out" / "report.html", tmp_path)
    check(heard)
    # The missing force is drawn in every frame, and changes with the slider.
    for shown in heard["players"]:
        first, last = (seen["arrows"] for seen in shown["seen"])
        assert last and all(d.startswith("M") for d in last) and first != last


def test_the_view_in_space_turns(tmp_path):
    """Dragged and by the arrow keys, but not by a mouse that only passes."""
    angles = np.linspace(0.0, 3.0, 12)
    bent = np.column_stack([0.1 * np.cos(angles), 0.05 * angles, 0.1 * np.sin(angles)])
    frames = [ShapeFrame(0.1 * k, observed=bent + 0.01 * k) for k in range(3)]
    shown = player(frames, 0.4, cameras={"left": np.array([-0.3, -1.2, 0.1])})
    write_page(tmp_path / "report.html", page("A helix", "", [Section("Shapes", shown)]))
    heard = opened(tmp_path / "report.html", tmp_path)
    check(heard)
    (turn,) = heard["players"][0]["turns"]
    assert turn["idle"] == turn["before"] != turn["dragged"]
    assert turn["released"] == turn["dragged"] != turn["keyed"]


def test_calibrate(tmp_path):
    lens, rng = usual_lens(), np.random.default_rng(4)
    pattern = "chessboard:9x6:0.025"
    texture, texel = chessboard(9, 6), 0.025 / 20
    (tmp_path / "views").mkdir()
    for k, (rotation, shift) in enumerate(poses(9, parse_pattern(pattern).points, rng)):
        picture = lens.picture(texture, texel, rotation, shift, rng)
        cv2.imwrite(str(tmp_path / "views" / f"view{k}.png"), picture)
    words = ["--pattern", pattern, "--output", tmp_path / "out", tmp_path / "views"]
    assert run("calibrate", *words) == 0
    check(opened(tmp_path / "out" / "report.html", tmp_path))


def test_the_ears_hear(tmp_path):
    """An error, a picture from elsewhere and a page that is too wide are noticed."""
    bad = tmp_path / "bad.html"
    bad.write_text(
        '<html><head></head><body><div style="width:3000px">x</div>'
        '<img src="http://example.invalid/x.png"><script>fetch("http://example.invalid");'
        "undefinedFunction();</script></body></html>"
    )
    heard = opened(bad, tmp_path)
    assert any("undefinedFunction" in e for e in heard["errors"])
    assert any("img" in e for e in heard["errors"]) or heard["loaded"]
    assert heard["asked"] == ["fetch http://example.invalid"]
    assert heard["wide"] > 1000
