"""Compiled functions: the same results, a cache, and clear complaints."""

from collections import Counter

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import Controller, laws, plants, signals, simulate
from tarc.core import codegen as native
from tarc.core.errors import CompilationError, MissingTool
from tarc.core.tracing import trace
from tarc.simulation import casadi_backend

REFERENCE = signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[2.0, 3.0])
SENSOR = signals.Encoder(bits=16, dropout=0.01)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.parametrize("synchronised", [False, True])
def test_fused_run_is_the_same(synchronised):
    law = make_law(laws.TARC, inertia=[0.15, 0.05], synchronised=synchronised)
    runs = [
        simulate(plants.TwoLinkArm(), law, REFERENCE, 0.5, sensor=SENSOR, initial_torque="rest", native=native)
        for native in (False, True)
    ]
    np.testing.assert_array_equal(runs[1].data["torque"], runs[0].data["torque"])
    np.testing.assert_array_equal(runs[1].data["missing"], runs[0].data["missing"])


def test_gains_are_arguments_of_the_machine_code():
    """Laws and plants that differ in their numbers share one library, and each gives its own bits."""
    for frequency, mass in ((41.3, 1.07), (57.9, 0.83)):
        law = make_law(laws.TARC, natural_frequency=frequency)
        plant = plants.TwoLinkArm(masses=[mass, 0.71])
        runs = [
            simulate(plant, law, REFERENCE, 0.2, sensor=SENSOR, native=native, substeps=1) for native in (False, True)
        ]
        np.testing.assert_array_equal(runs[1].data["torque"], runs[0].data["torque"])
    assert len(list(native.cache().glob("*.so"))) == 1


def test_many_runs_of_one_loop_are_compiled(monkeypatch):
    """Runs of one loop with other gains add up until compiling pays off."""
    monkeypatch.setattr(casadi_backend, "SHORT_RUN", 1e4)
    monkeypatch.setattr(casadi_backend, "COMPILATION", 1e6)
    monkeypatch.setattr(casadi_backend, "COMPILATION_PER_INSTRUCTION", 0.0)
    monkeypatch.setattr(casadi_backend, "_interpreted_work", Counter())
    n_compiled = []
    for frequency in np.linspace(41.3, 57.9, 12):
        law = make_law(laws.TARC, natural_frequency=frequency)
        simulate(plants.TwoLinkArm(), law, REFERENCE, 0.2, sensor=SENSOR, substeps=1)
        n_compiled.append(len(list(native.cache().glob("*.so"))))
    assert n_compiled[0] == 0
    assert n_compiled[-1] == 1


def test_mujoco_run_is_the_same():
    arm = plants.MujocoPlant.from_file("panda", armature=0.1, coulomb=1.0)
    law = make_law(laws.TARC, 7, inertia=0.1 * arm.inertia(arm.home))
    reference = signals.Sinusoid(amplitude=0.2, frequency=2.0, offset=arm.home)
    runs = [
        simulate(arm, law, reference, 0.3, sensor=SENSOR, initial_torque="rest", native=native)
        for native in (False, True)
    ]
    np.testing.assert_array_equal(runs[1].data["torque"], runs[0].data["torque"])


def test_controller_is_the_same_and_bridges_lost_samples():
    torques = []
    for compiled in (False, True):
        controller = Controller(make_law(laws.TARC), native=compiled)
        controller.reset(np.zeros(2))
        for position in ([0.0, 0.1], [np.nan, 0.1], [0.01, np.inf], [0.02, 0.1]):
            torque = controller.step(position, [0.1, 0.1], [0.0, 0.0], [0.0, 0.0])
        torques.append(torque.copy())
    np.testing.assert_array_equal(*torques)


def test_second_time_loads_what_was_compiled(monkeypatch):
    function, _ = trace(*((law := make_law(laws.TDC)).step, *law.example()))
    native.compiled(function)
    (library,) = native.cache().glob("*.so")
    build_time = library.stat().st_mtime_ns

    def fail(*_, **__):
        raise AssertionError("compiled again")

    monkeypatch.setattr("subprocess.run", fail)
    native.compiled(function)
    assert library.stat().st_mtime_ns == build_time
    assert [path.name for path in native.cache().iterdir()] == [library.name], "no litter"


def test_a_missing_compiler_is_reported(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingTool, match=r"no C compiler found; looked for \$CC, cc, gcc, clang .* pip install"):
        Controller(make_law(laws.TDC), native=True)


def test_a_failing_compiler_is_reported(monkeypatch):
    monkeypatch.setenv("CC", "false")
    with pytest.raises(CompilationError, match="native: false .* failed"):
        Controller(make_law(laws.TDC), native=True)


def test_a_wrong_compiler_is_reported(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(MissingTool, match="there is no compiler 'no-such-compiler'; correct or unset"):
        Controller(make_law(laws.TDC), native=True)


def test_a_cache_that_cannot_be_written_is_reported(monkeypatch, tmp_path):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "taken"))
    with pytest.raises(CompilationError, match="native: cannot compile into .*; set XDG_CACHE_HOME"):
        Controller(make_law(laws.TDC), native=True)
