"""Exported packages of ROS 2: they compile for each version's signatures, and give the law's torques bit for bit.

The interfaces are stubs (see ``ros2_stubs``): they prove compilation and the numbers, not that it works in ROS.
"""

import ast
import runpy
import shutil
import subprocess
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.export import export_c, export_ros2, vectors, verify_export
from tarc.export.c_source import CSource
from tarc.export.traced_law import traced_law
from tarc.scenario.yaml_text import read_yaml
from tarc.signals.joint_trajectory import hermite_curve

HERE = Path(__file__).parent
JOINTS = ("shoulder", "elbow")
FLAGS = ["-std=c++17", "-O1", "-fPIC", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
VERSIONS = {"humble": (2, 54), "jazzy": (4, 46), "rolling": (6, 8), "early jazzy": (4, 21), "kilted": (5, 16)}
STEPS = 2000

needs_gpp = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")


def make_law(**options):
    period = options.pop("period", 1e-3)
    return tarc.laws.TDC(
        inertia=[0.1, 0.2],
        natural_frequency=10.0,
        period=period,
        estimator=tarc.estimators.Algebraic(window=10 * period),
        torque_limit=[20.0, 10.0],
        max_missing=30,
        **options,
    )


def run(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)


def build(folder, target, version, source, *options):
    """Compile a file of the package, or one that includes its headers, with the C of the law."""
    stubs = [f"-DSTUB_MAJOR={version[0]}", f"-DSTUB_MINOR={version[1]}", "-isystem", HERE / "ros2_stubs"]
    c_file = folder / "arm.o"
    if not c_file.exists():
        made = run("gcc", "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-c", folder / "src/arm.c", "-o", c_file)
        assert made.returncode == 0, made.stderr
    made = run("g++", *FLAGS, *stubs, f"-I{folder / 'src'}", *options, source, c_file, "-o", target, "-ldl")
    assert made.returncode == 0, made.stderr
    assert made.stderr == ""


def recorded(law, real="double"):
    """Write inputs as the replay reads them, and return them with the law's torques."""
    source = CSource(traced_law(law), "arm", real == "float", "")
    position, torque, inputs = vectors.random_inputs(2, STEPS, 5)
    inputs[np.abs(inputs) > 1e100] = np.nan
    result = vectors.record(source, position, torque, inputs)
    start = np.concatenate([result.position, result.torque]).astype(float)
    return np.concatenate([start, result.inputs.astype(float).ravel()]), result.outputs[:, :2].astype(float)


def points():
    """Points with positions alone, then velocities, then accelerations: time, q, dq, ddq."""
    nan = np.nan
    return np.array(
        [
            [0.2005, 0.5, -0.4, nan, nan, nan, nan],
            [0.4005, 0.3, -0.2, 0.1, 0.2, nan, nan],
            [0.6005, 0.6, 0.0, -0.1, 0.3, nan, nan],
            [0.7005, 0.5, 0.1, 0.2, 0.0, 0.5, -1.0],
            [0.9005, 0.4, 0.2, 0.0, 0.0, 0.0, 0.0],
        ]
    )


def replay(package, work, version, real="double"):
    """Compile, load by the names in the plugin description, and compare all torques; return what was printed."""
    law = make_law()
    description = ElementTree.parse(package / "arm_controller.xml").getroot()
    library = work / f"lib{description.attrib['path']}.so"
    kind = description[0].attrib["type"]
    build(package, library, version, package / "src/controller.cpp", "-shared")
    program = work / "replay"
    build(package, program, version, HERE / "ros2_replay.cpp", "-rdynamic", "-Wno-deprecated-declarations")
    inputs, expected = recorded(law, real)
    inputs.tofile(work / "inputs")
    points().tofile(work / "points")
    files = [work / "inputs", work / "torques", work / "points", work / "followed"]
    done = run(program, library, kind, 1000, "left_", *files)
    assert done.returncode == 0, done.stdout + done.stderr
    found = np.fromfile(work / "torques").reshape(-1, 2)
    np.testing.assert_array_equal(found.view(np.uint64), expected.view(np.uint64))
    follow(np.fromfile(work / "followed").reshape(-1, 2, 3))
    refused = run(program, library, kind, 500, "", *files)
    assert refused.returncode == 3
    assert "update_rate: got 500 Hz; the law is for 1000 Hz" in refused.stdout
    return done.stdout


def follow(found):
    """Compare references without a controller ahead with the reference of the package."""
    rows = np.vstack([[0.0, 0.25, -0.5, 0, 0, 0, 0], points()])
    curve = hermite_curve(rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5:7])
    times = np.arange(1000) / 1000
    inside = times < 0.9005
    for order in range(3):
        np.testing.assert_allclose(found[inside, :, order], curve(times[inside], order), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found[~inside][:, :, 0], np.tile([0.4, 0.2], (99, 1)))
    np.testing.assert_array_equal(found[~inside][:, :, 1:], 0.0)


@needs_gpp
@pytest.mark.slow
@pytest.mark.parametrize("name", VERSIONS)
def test_the_plugin_compiles_and_gives_the_torques_of_python(name, tmp_path):
    export_ros2(make_law(), tmp_path / "package", name="arm", joint_names=JOINTS)
    printed = replay(tmp_path / "package", tmp_path, VERSIONS[name])
    assert f"{STEPS} steps" in printed
    assert "left what" not in printed
    assert "got the joints wrist, left_shoulder; the law is for left_shoulder, left_elbow" in printed


@needs_gpp
@pytest.mark.slow
def test_the_plugin_in_single_precision_with_a_watch(tmp_path):
    watch = tarc.Watch(n_joints=2, tube=1e-3, period=1e-3)
    export_ros2(make_law(), tmp_path / "package", name="arm", joint_names=JOINTS, real="float", watch=watch)
    printed = replay(tmp_path / "package", tmp_path, VERSIONS["rolling"], "float")
    assert f"{STEPS} steps" in printed
    assert "left what was certified: flags 2 of arm.h" in printed


@needs_gpp
@pytest.mark.slow
def test_the_plugin_refuses_other_joints(tmp_path):
    package = tmp_path / "package"
    export_ros2(make_law(), package, name="arm", joint_names=("shoulder", "wrist"))
    build(package, tmp_path / "plugin.so", (6, 8), package / "src/controller.cpp", "-shared")
    build(package, tmp_path / "replay", (6, 8), HERE / "ros2_replay.cpp", "-rdynamic", "-Wno-deprecated-declarations")
    done = run(tmp_path / "replay", tmp_path / "plugin.so", "arm_controller::Controller", 1000, "", "", "")
    assert done.returncode == 3
    assert "Missing: wrist; unknown or twice: elbow" in done.stdout


@needs_gpp
@pytest.mark.slow
def test_the_node_steps_by_the_stamps_and_bridges_gaps(tmp_path):
    law, package = make_law(), tmp_path / "package"
    export_ros2(law, package, name="arm", joint_names=JOINTS)
    program = tmp_path / "node"
    build(package, program, (4, 46), HERE / "ros2_node_replay.cpp")
    build(package, tmp_path / "main", (4, 46), package / "src/node_main.cpp")
    rng = np.random.default_rng(2)
    times = 5.0 + 1e-3 * np.arange(400) + rng.uniform(-1e-4, 1e-4, 400)
    positions = np.cumsum(rng.normal(0, 1e-4, (400, 2)), axis=0)
    kept = np.setdiff1d(np.arange(400), [100, 101, 150])
    kept = np.insert(kept, 200, kept[199])  # one comes twice
    np.column_stack([times, positions])[kept].tofile(tmp_path / "states")
    done = run(program, 1000, tmp_path / "states", tmp_path / "torques")
    assert done.returncode == 0
    assert done.stdout.startswith(f"{2 * len(kept) + 1} ignored; 1 after silence; joint_states: they lack elbow")
    found = np.fromfile(tmp_path / "torques").reshape(-1, 3)
    controller, start = tarc.Controller(law), 20
    controller.reset(positions[start])
    zero = np.zeros(2)
    expected = []
    for k in range(start + 1, 400):
        position = positions[k] if k in kept else np.full(2, np.nan)
        torque = controller.step(position, positions[start], zero, zero).copy()
        if k in kept:
            expected.append(torque)
    found = found[np.insert(np.diff(found[:, 0]) > 0, 0, False)]
    np.testing.assert_array_equal(found[:, 1:], expected)
    assert found[-1, 0] == 400 - start - 1  # a torque for each period, gaps included
    refused = run(program, 250, tmp_path / "states", tmp_path / "torques")
    assert "update_rate: got 250 Hz; the law is for 1000 Hz" in refused.stdout
    np.column_stack([5.0 + 2e-3 * np.arange(100), positions[:100]]).tofile(tmp_path / "slow")
    done = run(program, 1000, tmp_path / "slow", tmp_path / "torques")
    assert "they come at 500.0 Hz; the law is for 1000 Hz, and does not start" in done.stdout
    assert np.all(np.fromfile(tmp_path / "torques") == 0)


def test_the_package_has_all_parameters_and_names(tmp_path):
    law = make_law()
    written = export_ros2(law, tmp_path, name="arm", joint_names=JOINTS)
    texts = {file.relative_to(tmp_path).as_posix(): file.read_text() for file in written.files}
    parameters = read_yaml(texts["config/arm.yaml"], "arm.yaml")
    assert parameters["controller_manager"]["ros__parameters"]["update_rate"] == 1000
    assert "#   natural_frequency: 10.0\n" in texts["config/arm.yaml"]
    assert "#   torque_limit: [20.0, 10.0]\n" in texts["config/arm.yaml"]
    assert "certificate" not in texts["config/arm.yaml"]
    assert parameters["arm_controller"]["ros__parameters"]["joints"] == list(JOINTS)
    ahead = parameters["joint_trajectory_controller"]["ros__parameters"]
    assert ahead["command_joints"] == ["arm_controller/shoulder", "arm_controller/elbow"]
    assert ahead["command_interfaces"] == ["position", "velocity", "acceleration"]
    description = ElementTree.fromstring(texts["package.xml"])
    depends = {tag.text for tag in description.findall("depend")}
    cmake = texts["CMakeLists.txt"]
    assert all(f"find_package({name} REQUIRED)" in cmake for name in depends)
    assert "-ffp-contract=off" in cmake
    assert ElementTree.fromstring(texts["arm_controller.xml"])[0].attrib["name"] == "arm_controller/Controller"
    ast.parse(texts["launch/arm.launch.py"])
    assert not any("$" in text for path, text in texts.items() if path.endswith((".cpp", ".hpp", ".yaml", ".py")))
    assert "natural_frequency: 10.0" in texts["law.yaml"]


PACKAGES = ("controller_interface", "hardware_interface", "pluginlib", "rclcpp", "rclcpp_lifecycle")
PACKAGES += ("sensor_msgs", "std_msgs", "trajectory_msgs")


@needs_gpp
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no cmake")
def test_cmake_builds_installs_and_tests_the_package(tmp_path):
    package, modules, build_folder = tmp_path / "package", tmp_path / "modules", tmp_path / "build"
    export_ros2(make_law(), package, name="arm", joint_names=JOINTS)
    modules.mkdir()
    for name in PACKAGES:
        (modules / f"{name}Config.cmake").write_text(
            f"add_library({name}::{name} INTERFACE IMPORTED)\n"
            f"target_include_directories({name}::{name} INTERFACE {HERE / 'ros2_stubs'})\n"
            f"target_compile_definitions({name}::{name} INTERFACE STUB_MAJOR=4 STUB_MINOR=46)\n"
            f"set({name}_TARGETS {name}::{name})\n"
            "function(pluginlib_export_plugin_description_file base file)\n"
            "  install(FILES ${file} DESTINATION share/plugins)\nendfunction()\n"
        )
    (modules / "ament_cmakeConfig.cmake").write_text("include(CTest)\nfunction(ament_package)\nendfunction()\n")
    folders = [f"-D{name}_DIR={modules}" for name in (*PACKAGES, "ament_cmake")]
    for command in (
        ["cmake", "-S", package, "-B", build_folder, f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'install'}", *folders],
        ["cmake", "--build", build_folder],
        ["ctest", "--test-dir", build_folder, "--output-on-failure"],
        ["cmake", "--install", build_folder],
    ):
        done = run(*command)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning" not in done.stdout + done.stderr
    installed = {file.relative_to(tmp_path / "install").as_posix() for file in (tmp_path / "install").rglob("*.*")}
    assert {"lib/libarm_controller.so", "share/plugins/arm_controller.xml"} <= installed
    assert {
        f"share/arm_controller/{file}" for file in ("config/arm.yaml", "launch/arm.launch.py", "law.yaml")
    } <= installed


class Recorded:
    """A class of the launch system, of which the tests see what it was given."""

    def __init__(self, *given, **named):
        self.given, self.named = given, named


def stub_launch(monkeypatch):
    """Put modules with the classes of the launch system in place of those of ROS."""
    modules = {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "IncludeLaunchDescription", "OpaqueFunction"],
        "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
        "launch.substitutions": ["Command", "LaunchConfiguration", "PathJoinSubstitution"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterFile", "ParameterValue"],
        "launch_ros.substitutions": ["FindPackageShare"],
    }
    for name, classes in modules.items():
        module = types.ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (Recorded,), {"perform": lambda self, chosen: chosen}))
        monkeypatch.setitem(sys.modules, name, module)


def test_the_launch_file_starts_what_it_says(tmp_path, monkeypatch):
    export_ros2(make_law(), tmp_path, name="arm", joint_names=JOINTS)
    stub_launch(monkeypatch)
    launch = runpy.run_path(str(tmp_path / "launch" / "arm.launch.py"))
    arguments = launch["generate_launch_description"]().given[0]
    assert [argument.given[0] for argument in arguments[:2]] == ["robot", "simulator"]
    start = arguments[2].named["function"]
    executables = {
        chosen: [node.named.get("executable", "include") for node in start(chosen)]
        for chosen in ("mujoco", "gz", "none")
    }
    assert executables == {
        "mujoco": ["robot_state_publisher", "ros2_control_node", "spawner"],
        "gz": ["robot_state_publisher", "include", "create", "spawner"],
        "none": ["spawner"],
    }
    spawned = start("none")[0].named["arguments"]
    assert spawned[:3] == ["joint_state_broadcaster", "arm_controller", "joint_trajectory_controller"]
    with pytest.raises(RuntimeError, match="needs mujoco, gz or none"):
        start("webots")


@pytest.mark.slow
def test_the_c_of_the_package_is_that_of_the_project(tmp_path):
    law = make_law()
    package = export_ros2(law, tmp_path / "package", name="arm", joint_names=JOINTS)
    project = export_c(law, tmp_path / "project", name="arm", joint_names=JOINTS)
    assert package.digest == project.digest
    report = verify_export(package.folder, law=law, steps=500)
    assert report.passed


@pytest.mark.parametrize(
    ("options", "names", "message"),
    [
        ({"period": 0.003}, JOINTS, "0.003003 s would be 333 Hz"),
        ({}, ("a", "b", "c"), "needs 2 different names"),
        ({}, ("a", "a"), "needs 2 different names"),
        ({}, ("a", 'b"'), "without spaces, slashes and quotes"),
    ],
)
def test_what_ros_cannot_have_is_refused(options, names, message, tmp_path):
    law = make_law(**options)
    with pytest.raises(InvalidParameter, match=message):
        export_ros2(law, tmp_path, name="arm", joint_names=names)
    assert list(tmp_path.iterdir()) == []
