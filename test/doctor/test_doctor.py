# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""What `doctor` finds wrong, and that it finds nothing where all is well; no node runs here."""

import importlib
import sys
from types import SimpleNamespace

import pytest
from doctor_graphs import DEFAULT, HEALTHY, bad, one, simulated

from dlo_ros.cli import main as cli
from dlo_ros.dependencies import DEPENDENCIES, missing
from dlo_ros.doctor import environment, installation
from dlo_ros.doctor.finding import WIDTH, Level, ok, page, warning, worst, wrong
from dlo_ros.doctor.parameter_check import judge, judge_file
from dlo_ros.errors import KernelError
from dlo_ros.parameters import Settings


def test_the_page_can_be_read():
    sections = {
        "First": [ok("well"), wrong("x" * 30 + " " + "y" * 80, "mend it"), warning("doubtful")],
        "Empty": [],
    }
    text = page("title", sections)
    assert text.splitlines()[0] == "title" and "Empty" not in text
    assert "  WRONG    xxx" in text and "-> mend it" in text
    assert text.endswith("1 thing is wrong, 1 warning")
    assert max(map(len, text.splitlines())) <= WIDTH
    assert worst(sections["First"]) == Level.WRONG and worst([]) == Level.OK
    assert page("t", {"a": [ok("b")]}).endswith("nothing is wrong")
    assert page("t", {"a": [wrong("b", "c")] * 2}).endswith("2 things are wrong")


def test_what_is_installed_here_is_well():
    found = installation.installed("0")
    assert not bad(found) and "numpy" in found[1].text and "numba" in found[1].text


def test_a_library_that_is_missing_old_or_broken_is_told():
    def importer(name):
        if name in ("numba", "rclpy"):
            raise ModuleNotFoundError(name, name=name)
        if name == "scipy":
            raise ImportError("numpy.core.multiarray failed to import\nmore")
        if name == "rosbags":
            return SimpleNamespace(__version__="0.9.1")
        if name == "cv2":  # Ubuntu's
            return SimpleNamespace(__version__="4.6.0", aruco=None)
        return importlib.import_module(name)

    found = installation.installed("0", importer)
    told = {f.text.split()[0]: f for f in bad(found)}
    assert set(told) == {"numba", "scipy", "rosbags"}
    assert "pip install numba" in told["numba"].remedy
    assert "multiarray" in told["scipy"].text and "NumPy" in told["scipy"].remedy
    assert "older than 0.11.7" in told["rosbags"].text
    one(found, "rclpy is not installed", level=Level.WARNING)


@pytest.mark.parametrize(
    ("older", "newer"), [("1.9.3", "1.10"), ("4.6.0", "4.7"), ("2.0rc1", "2.1"), ("9", "unknown")]
)
def test_versions_compare_as_numbers(older, newer):
    assert installation.numbers(older) < installation.numbers(newer)


def test_rclpy_of_another_python_is_wrong():
    def importer(name):
        if name == "rclpy":
            raise ImportError("_rclpy_pybind11.cpython-312 cannot be loaded")
        return importlib.import_module(name)

    one(installation.installed("0", importer), "rclpy cannot be imported", "Python")


def test_kernels_that_cannot_be_kept():
    assert not bad(installation.judge_kernels("/cache", True, []))
    one(
        installation.judge_kernels("/cache", True, ["rod"]),
        "rod", "dlo_ros.compile", level=Level.WARNING,
    )  # fmt: skip
    one(installation.judge_kernels("/cache", False, ["rod"]), "/cache", "NUMBA_CACHE_DIR")


def test_kernels_without_numba(monkeypatch):
    from dlo_ros import kernel_cache

    monkeypatch.setitem(sys.modules, "numba", None)
    kernel_cache.cache_folder.cache_clear()
    one(installation.kernels(), "numba is not installed", "pip install")
    kernel_cache.cache_folder.cache_clear()


def test_every_library_says_how_to_get_it():
    for dependency in DEPENDENCIES:
        assert "pip install" in dependency.missing
        assert missing(f"{dependency.module}.part") == dependency.missing
    assert "apt install python3-scipy" in missing("scipy.signal")
    assert "numba" in missing("llvmlite.binding") and "ROS 2" in missing("sensor_msgs.msg")
    assert missing("dlo_ros.no_such") is None


@pytest.mark.parametrize(
    ("name", "value", "level"),
    [
        ("ROS_DOMAIN_ID", "42", Level.OK),
        ("ROS_DOMAIN_ID", "150", Level.WARNING),
        ("ROS_DOMAIN_ID", "233", Level.WRONG),
        ("ROS_DOMAIN_ID", "left", Level.WRONG),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST", Level.OK),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", Level.WRONG),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", Level.WRONG),
        ("ROS_LOCALHOST_ONLY", "1", Level.WARNING),
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", Level.WARNING),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/no/such.xml", Level.WRONG),
        ("ROS_DISTRO", "humble", Level.WARNING),
    ],
)
def test_variables_of_the_environment(name, value, level):
    assert worst(environment.network({})) == Level.OK
    found = environment.network({name: value})
    assert worst(found) == level
    assert level == Level.OK or any(name in f.text or value in f.text for f in bad(found, level))


def test_little_shared_memory_is_told(tmp_path, monkeypatch):
    assert environment.shared_memory(tmp_path / "none") == []
    monkeypatch.setattr(
        environment.shutil, "disk_usage", lambda _: SimpleNamespace(free=environment.ROOM - 1)
    )
    one(environment.shared_memory(tmp_path), "images may be lost", level=Level.WARNING)


def test_the_bundled_parameters_are_usual():
    found, settings = judge_file(DEFAULT)
    assert worst(found) == Level.OK and settings == Settings.load(DEFAULT)


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("rod.length", 40.0, "centimetres"),
        ("rod.diameter", 0.04, "slender"),
        ("rod.density", 1.2, "g/cm^3"),
        ("rod.young_modulus", 2000.0, "MPa"),
        ("rod.young_modulus", 1e11, "weight"),
        ("gravity", [0.0, 0.0, 9.81], "z points up"),
        ("gravity", [0.0, 0.0, -1.6], "9.81"),
        ("damping.air_drag", 10.0, "honey"),
        ("damping.relaxation_time", 2.0, "milliseconds"),
        ("simulation.tolerance", 0.05, "taken for"),
        ("camera.translation", [0.0, 0.0, 120.0], "millimetres"),
        ("camera.rotation", [0.0, 0.0, 0.0, 1.0], "degrees"),
        ("camera.rotation", [-0.70710678, 0.0, 0.0, 0.70710678], "behind"),
        ("camera.rotation", [0.72, 0.0, 0.0, 0.72], "unit quaternion"),
        ("limits.bend_radius", 0.001, "radius"),
    ],
)
def test_an_unusual_value_is_told_with_what_is_meant(name, value, word):
    values = Settings.load(DEFAULT).flat() | {name: value}
    found = judge(Settings.from_mapping(values))
    assert not bad(found) and any(word in f"{f.text} {f.remedy}" for f in found), found


def test_what_cannot_be_is_wrong():
    values = Settings.load(DEFAULT).flat()
    behind = values | {"camera.translation": [0.0, 0.0, -1.2]}
    one(judge(Settings.from_mapping(behind)), "behind the camera")
    masked = values | {"vision.mask": "no/such.png"}
    one(judge(Settings.from_mapping(masked)), "vision.mask", "no/such.png")


def test_a_file_that_does_not_load_is_wrong(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text("/**:\n  ros__parameters:\n    rod: {length: -1.0}\n")
    found, settings = judge_file(file)
    assert settings is None
    one(found, "rod.length is -1")
    one(judge_file(tmp_path / "none.yaml")[0], "none.yaml")


def test_unknown_names_and_a_missing_camera_are_told(tmp_path, caplog):
    file = tmp_path / "params.yaml"
    rod = "{length: 0.4, diameter: 0.004, young_modulus: 1.0e+6, density: 2000.0, lenght: 0.4}"
    file.write_text(f"/**:\n  ros__parameters:\n    rod: {rod}\n...\n")
    found, settings = judge_file(file)
    assert settings is not None and not caplog.records  # told on the page alone
    texts = [f.text for f in bad(found, Level.WARNING)]
    assert len(texts) == 2 and "rod.lenght" in texts[0] and "no block camera" in texts[1]


def test_the_tool_ends_with_1_where_something_is_wrong(monkeypatch, capsys, tmp_path):
    assert cli.main(["doctor", "--seconds", "0", "--params", str(DEFAULT)]) == 0
    assert "nothing is wrong" in capsys.readouterr().out
    assert cli.main(["doctor", "--seconds", "0", "--params", str(tmp_path / "none.yaml")]) == 1
    assert "1 thing is wrong" in capsys.readouterr().out
    assert cli.main(["doctor", "--seconds", "-1"]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_the_tool_listens(monkeypatch, capsys):
    watching = pytest.importorskip("dlo_ros.nodes.graph_watch")
    monkeypatch.setattr(watching, "watch", lambda seconds: HEALTHY)
    assert cli.main(["doctor"]) == 0
    assert "/observer: works" in capsys.readouterr().out
    monkeypatch.setattr(watching, "watch", lambda seconds: simulated())
    assert cli.main(["doctor"]) == 1

    def fail(seconds):
        raise RuntimeError("failed to initialize\nrcl node")

    monkeypatch.setattr(watching, "watch", fail)
    assert cli.main(["doctor"]) == 1
    assert "ROS does not start: failed to initialize rcl node" in capsys.readouterr().out

    def without_kernels(seconds):
        raise KernelError("numba is not installed")

    monkeypatch.setattr(watching, "watch", without_kernels)
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert (
        "the ROS graph cannot be observed: numba is not installed" in out
        and "ROS does not" not in out
    )


def test_without_ros_the_rest_is_told(monkeypatch, capsys):
    monkeypatch.setattr(installation, "kernels", lambda: [])  # compiled or not: another matter
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delitem(sys.modules, "dlo_ros.nodes.graph_watch", raising=False)
    assert cli.main(["doctor"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "rclpy is not installed: the nodes" in out
        and "the ROS graph cannot be observed without" in out
    )
    assert "2 warnings" in out
