"""Exported FMUs: valid, the same bits as the law in every way of calling, and clear about what they refuse."""

import subprocess
import sys
import zipfile
from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

import tarc
from law_catalogue import concrete_laws, make_law
from tarc.core.errors import InvalidParameter, MissingTool, UnsupportedLaw
from tarc.export import export_fmu, fmu_platforms, vectors
from tarc.signals import TorqueLimits

fmpy = pytest.importorskip("fmpy")
from fmpy.fmi1 import FMICallException  # noqa: E402 - fmpy may be missing
from fmpy.fmi2 import FMU2Model, FMU2Slave  # noqa: E402 - fmpy may be missing
from fmpy.fmi3 import FMU3Model, FMU3Slave  # noqa: E402 - fmpy may be missing
from fmpy.validation import validate_fmu  # noqa: E402 - fmpy may be missing

PERIOD = 1e-3
INPUTS = ("position", "reference", "velocity_reference", "acceleration_reference", "applied_torque")
KINDS = {"2.0": (FMU2Slave, FMU2Model), "3.0": (FMU3Slave, FMU3Model)}


def tdc(**options):
    return tarc.laws.TDC(
        inertia=[0.1, 0.2],
        natural_frequency=10.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        torque_limit=[3.0, 5.0],
        **options,
    )


@pytest.fixture(scope="module")
def quickly_compiled():
    """Compile without optimisation, which gives the same bits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu_platforms, "FLAGS", tuple({"-O2": "-O0"}.get(flag, flag) for flag in fmu_platforms.FLAGS))
        yield


@pytest.fixture(scope="module")
def files(tmp_path_factory, quickly_compiled):
    folder = tmp_path_factory.mktemp("fmu")
    return {
        fmi: export_fmu(tdc(), folder / f"law{fmi[0]}.fmu", name="law", fmi=fmi, tunable=["natural_frequency"]).file
        for fmi in ("2.0", "3.0")
    }


class Instance:
    """An FMU in FMPy, its variables by name."""

    def __init__(self, file, folder, model_exchange=False, event_mode=False):
        self.description = fmpy.read_model_description(str(file))
        self.fmi = self.description.fmiVersion
        unzipped = fmpy.extract(str(file), unzipdir=str(folder))
        self.messages = []
        self.fmu = KINDS[self.fmi][model_exchange](
            guid=self.description.guid,
            unzipDirectory=unzipped,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="law",
        )
        options = {"eventModeUsed": True} if event_mode else {}
        if self.fmi == "3.0":
            self.fmu.instantiate(logMessage=lambda *values: self.messages.append(values[-1].decode()), **options)
        else:
            from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

            self.callbacks = fmi2CallbackFunctions()
            self.callbacks.logger = fmi2CallbackLoggerTYPE(lambda *values: self.messages.append(values[4].decode()))
            self.fmu.instantiate(callbacks=self.callbacks)
        self.variables = {}
        for variable in self.description.modelVariables:
            self.variables.setdefault(variable.name.partition("[")[0], []).append(variable)

    def initialize(self, start_time=0.0, **values):
        if self.fmi == "2.0":
            self.fmu.setupExperiment(startTime=start_time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start_time)
        self.set(**values)
        self.fmu.exitInitializationMode()

    def set(self, **values):
        for name, value in values.items():
            variables = self.variables[name]
            setter = self.fmu.setBoolean if variables[0].type == "Boolean" else self._set_real
            setter([one.valueReference for one in variables], np.atleast_1d(value).tolist())

    def _set_real(self, references, values):
        (self.fmu.setReal if self.fmi == "2.0" else self.fmu.setFloat64)(references, values)

    def get(self, name):
        variables = self.variables[name]
        references = [one.valueReference for one in variables]
        kind = {"Integer": "Int32", "Real": "Float64"}.get(variables[0].type, variables[0].type)
        if self.fmi == "2.0":
            return np.array(getattr(self.fmu, f"get{variables[0].type}")(references), dtype=float)
        size = int(np.prod(variables[0].shape)) if variables[0].shape else 1
        return np.array(getattr(self.fmu, f"get{kind}")(references, size), dtype=float)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


def recorded(law=None, count=60, limits=None):
    """Return inputs, and the torques, missing counts and statuses of the controller."""
    law = law or tdc()
    position, _, inputs = vectors.random_inputs(law.n_joints, count, 4)
    n = law.n_joints
    inputs[0] = np.nan_to_num(inputs[0], nan=0.1, posinf=0.1, neginf=0.1)
    inputs[0, :n] = position
    controller = tarc.Controller(law, torque_limits=limits)
    controller.reset(position)
    torques = [
        [*controller.step(*np.split(row[: 4 * n], 4), applied_torque=row[4 * n :]), controller.missing]
        for row in inputs
    ]
    return SimpleNamespace(inputs=inputs, expected=np.array(torques), n=n)


def row_of(data, k):
    return dict(zip(INPUTS, np.split(data.inputs[k], 5), strict=True))


def co_simulate(instance, data):
    instance.initialize(uses_applied_torque=True)
    found = []
    for k in range(len(data.inputs)):
        instance.set(**row_of(data, k))
        instance.fmu.doStep(k * PERIOD, PERIOD)
        found.append([*instance.get("torque"), *instance.get("missing")])
    return np.array(found)


def update(instance, fmi):
    again, times, next_time = True, 0, np.nan
    while again:
        values = instance.fmu.newDiscreteStates() if fmi == "2.0" else instance.fmu.updateDiscreteStates()
        again, next_time = values[0], values[-1]
        times += 1
    return times, next_time


def exchange_model(instance, data):
    instance.initialize(uses_applied_torque=True)
    found, time = [], 0.0
    for k in range(len(data.inputs)):
        if k:
            instance.fmu.setTime(time)
            instance.fmu.enterEventMode()
            instance.set(position=np.full(data.n, 1e3))  # taken back within the same instant
            if instance.fmi == "2.0":
                instance.fmu.newDiscreteStates()
            else:
                instance.fmu.updateDiscreteStates()
        instance.set(**row_of(data, k))
        _, time = update(instance, instance.fmi)
        instance.fmu.enterContinuousTimeMode()
        found.append([*instance.get("torque"), *instance.get("missing")])
    assert time == pytest.approx(len(data.inputs) * PERIOD)
    return np.array(found)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_the_validator_finds_nothing(files, fmi):
    assert validate_fmu(str(files[fmi])) == []


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("run", [co_simulate, exchange_model])
def test_the_torques_have_the_bits_of_the_controller(files, fmi, run, tmp_path):
    data = recorded()
    instance = Instance(files[fmi], tmp_path, model_exchange=run is exchange_model)
    np.testing.assert_array_equal(run(instance, data), data.expected)
    instance.close()


def test_event_mode_of_co_simulation_gives_the_torque_at_its_sample(files, tmp_path):
    data = recorded()
    instance = Instance(files["3.0"], tmp_path, event_mode=True)
    instance.initialize(uses_applied_torque=True)
    found = []
    for k in range(len(data.inputs)):
        instance.set(**row_of(data, k))
        update(instance, "3.0")
        instance.fmu.enterStepMode()
        found.append([*instance.get("torque"), *instance.get("missing")])
        needs_event, *_ = instance.fmu.doStep(k * PERIOD, PERIOD)
        assert needs_event
        instance.fmu.enterEventMode()
    np.testing.assert_array_equal(found, data.expected)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_saved_state_goes_on_with_the_same_bits(files, fmi, tmp_path):
    data = recorded()
    first = Instance(files[fmi], tmp_path / "1")
    first.initialize(uses_applied_torque=True)
    is_2 = fmi == "2.0"
    save = first.fmu.getFMUstate if is_2 else first.fmu.getFMUState
    for k in range(30):
        first.set(**row_of(data, k))
        first.fmu.doStep(k * PERIOD, PERIOD)
    state = save()
    content = (first.fmu.serializeFMUstate if is_2 else first.fmu.serializeFMUState)(state)
    second = Instance(files[fmi], tmp_path / "2")
    restored = (second.fmu.deSerializeFMUstate if is_2 else second.fmu.deserializeFMUState)(content)
    for instance, memory in ((second, restored), (first, state), (first, state)):
        (instance.fmu.setFMUstate if is_2 else instance.fmu.setFMUState)(memory)
        for k in range(30, 60):
            instance.set(**row_of(data, k))
            instance.fmu.doStep(k * PERIOD, PERIOD)
            assert [*instance.get("torque"), *instance.get("missing")] == data.expected[k].tolist()
    wrong = bytes(len(content))
    with pytest.raises(FMICallException):
        (first.fmu.deSerializeFMUstate if is_2 else first.fmu.deserializeFMUState)(wrong)
    (first.fmu.freeFMUstate if is_2 else first.fmu.freeFMUState)(state)


def test_a_tuned_parameter_gives_the_torque_of_the_law_that_is_built_with_it(files, tmp_path):
    data, tuned = recorded(), recorded(replace(tdc(), natural_frequency=14.5))
    instance = Instance(files["2.0"], tmp_path)
    instance.set(natural_frequency=14.5)
    np.testing.assert_allclose(co_simulate(instance, data), tuned.expected, rtol=0, atol=1e-9)
    assert np.any(data.expected != tuned.expected)
    for value in (np.nan, 0.5, 1000.0):
        with pytest.raises(FMICallException):
            instance.set(natural_frequency=value)


def refused(instance, call, *words):
    """Check that a call fails, with these words in the message."""
    instance.messages.clear()
    with pytest.raises(FMICallException):
        call()
    message = " ".join(instance.messages)
    assert all(word in message for word in words), message


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_steps_that_are_not_the_period_are_refused(files, fmi, tmp_path):
    instance = Instance(files[fmi], tmp_path)
    refused(instance, lambda: instance.fmu.doStep(0.0, PERIOD), "must not be called after instantiation")
    instance.initialize(start_time=2.0)
    for size in (2 * PERIOD, 0.5 * PERIOD, 0.0, np.nan, -PERIOD):
        refused(instance, lambda size=size: instance.fmu.doStep(2.0, size), "must be the law's period, 0.001")
    refused(instance, lambda: instance.fmu.doStep(0.0, PERIOD), "the last step ended at 2 s")
    instance.fmu.doStep(2.0, PERIOD * (1 + 1e-9))
    instance.fmu.doStep(2.0 + PERIOD, PERIOD)
    refused(instance, lambda: instance.fmu.doStep(2.0 + PERIOD, PERIOD), "the last step ended at")


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_another_token_is_refused(files, fmi, tmp_path):
    description = fmpy.read_model_description(str(files[fmi]))
    unzipped = fmpy.extract(str(files[fmi]), unzipdir=str(tmp_path))
    fmu = KINDS[fmi][0](guid="{0}", unzipDirectory=unzipped, modelIdentifier="law", instanceName="law")
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmu.instantiate()
    assert description.guid != "{0}"


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_variables_are_set_only_as_they_may_be(files, fmi, tmp_path):
    instance = Instance(files[fmi], tmp_path)
    refused(instance, lambda: instance.set(torque=[0.0, 0.0]), "torque must not be set")
    refused(instance, lambda: instance.set(initial_torque=[np.inf, 0.0]), "initial_torque, which must be finite")
    instance.initialize(initial_torque=[1.0, -9.0])
    np.testing.assert_array_equal(instance.get("torque"), [1.0, -5.0])  # within its limit
    refused(instance, lambda: instance.set(initial_torque=[0.0, 0.0]), "must not be set between steps")
    refused(instance, lambda: instance.set(uses_applied_torque=True), "must not be set between steps")
    set_real = instance.fmu.setReal if fmi == "2.0" else instance.fmu.setFloat64
    get_real = (lambda x: instance.fmu.getReal(x)) if fmi == "2.0" else (lambda x: instance.fmu.getFloat64(x, len(x)))
    refused(instance, lambda: set_real([10_000], [0.0]), "no variable of this type with the value reference 10000")
    refused(instance, lambda: get_real([10_000]), "no variable of this type")


def test_arrays_of_the_wrong_size_are_refused(files, tmp_path):
    instance = Instance(files["3.0"], tmp_path)
    (position,) = instance.variables["position"]
    for count in (0, 1, 3):
        refused(
            instance,
            lambda count=count: instance.fmu.setFloat64([position.valueReference], [0.0] * count),
            f"got {count} values; these variables have 2",
        )
    refused(instance, lambda: instance.fmu.setFloat64([position.valueReference + 1], [0.0]), "no variable")


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_without_a_position_the_torque_is_zero_until_there_is_one(files, fmi, tmp_path):
    data = recorded(count=4)
    instance = Instance(files[fmi], tmp_path)
    instance.initialize(uses_applied_torque=True, position=[np.nan, np.nan])
    for k in range(3):
        instance.fmu.doStep(k * PERIOD, PERIOD)
        assert instance.get("torque").tolist() == [0.0, 0.0]
        assert instance.get("status").tolist() == [1.0]
    for k in range(4):
        instance.set(**row_of(data, k))
        instance.fmu.doStep((k + 3) * PERIOD, PERIOD)
        assert [*instance.get("torque"), *instance.get("missing")] == data.expected[k].tolist()


def test_lost_positions_lead_to_the_fault_of_the_law(files, tmp_path):
    instance = Instance(files["2.0"], tmp_path)
    instance.initialize()
    for k in range(14):
        instance.fmu.doStep(k * PERIOD, PERIOD)
        instance.set(position=[np.nan, 0.0])
        assert instance.get("missing").tolist() == [k]
        assert instance.get("fault").tolist() == [float(k > 10)]
        assert instance.get("status").tolist() == [3.0 if k > 10 else 2.0 if k else 0.0]


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_time_event_that_is_left_out_is_an_error(files, fmi, tmp_path):
    instance = Instance(files[fmi], tmp_path, model_exchange=True)
    instance.initialize()
    times, next_time = update(instance, fmi)
    assert (times, next_time) == (2, PERIOD)  # the second time with what other models changed at this instant
    instance.fmu.enterContinuousTimeMode()
    instance.fmu.setTime(2.5 * PERIOD)
    instance.fmu.enterEventMode()
    refused(instance, lambda: update(instance, fmi), "the time event at 0.001 was left out")


def test_event_mode_of_co_simulation_must_be_entered_after_each_step(files, tmp_path):
    instance = Instance(files["3.0"], tmp_path, event_mode=True)
    instance.initialize()
    refused(instance, lambda: instance.fmu.doStep(0.0, PERIOD), "must not be called in event mode")
    instance.fmu.enterStepMode()
    refused(instance, lambda: instance.fmu.doStep(0.0, PERIOD), "the sample at 0 s was left out")


def test_reset_starts_again(files, tmp_path):
    data = recorded()
    instance = Instance(files["2.0"], tmp_path)
    for _ in range(2):
        np.testing.assert_array_equal(co_simulate(instance, data), data.expected)
        instance.fmu.reset()


def test_limits_of_the_interface_and_one_joint_are_exported(tmp_path, quickly_compiled):
    limits = TorqueLimits(rate=2000.0, magnitude=2.0)
    law = replace(tdc(), inertia=[0.1], torque_limit=None)
    data = recorded(law, limits=limits)
    written = export_fmu(law, tmp_path / "one.fmu", torque_limits=limits, joint_names=["elbow"], tunable=[])
    instance = Instance(written.file, tmp_path / "out")
    np.testing.assert_array_equal(co_simulate(instance, data), data.expected)
    assert instance.variables["torque"][0].name == "torque[1]"
    assert instance.variables["torque"][0].description.endswith(": elbow")
    assert validate_fmu(str(written.file)) == []
    assert fmpy.read_model_description(str(written.file)).defaultExperiment.stepSize == "0.001"


def test_a_law_of_positions_waits_at_its_initial_command(tmp_path, quickly_compiled):
    law = replace(tdc(safe_torque="hold"), torque_limit=None)
    written = export_fmu(law, tmp_path / "servo.fmu", commands=("rad", "rad"), tunable=[])
    instance = Instance(written.file, tmp_path / "out")
    instance.initialize(initial_torque=[0.4, -0.7], position=[np.nan, 0.0])
    instance.fmu.doStep(0.0, PERIOD)
    np.testing.assert_array_equal(instance.get("torque"), [0.4, -0.7])
    assert instance.variables["torque"][0].description == "command of the inner loops [rad]"


def test_the_same_law_gives_the_same_bytes_and_files_of_others_stay(tmp_path):
    options = {"name": "law", "tunable": [], "platforms": []}
    one, two = (export_fmu(tdc(), tmp_path / name, **options).file for name in ("1.fmu", "2.fmu"))
    assert one.read_bytes() == two.read_bytes()
    export_fmu(tdc(), one, **options)  # its own file it may replace
    with zipfile.ZipFile(two, "a") as archive:
        archive.writestr("notes.txt", "mine")
    (tmp_path / "3.fmu").write_text("mine")
    (tmp_path / "4.fmu").mkdir()
    for name in ("2.fmu", "3.fmu", "4.fmu"):
        with pytest.raises(InvalidParameter, match="was not written by this command"):
            export_fmu(tdc(), tmp_path / name, **options)
    assert (tmp_path / "3.fmu").read_text() == "mine"


def test_what_is_in_the_fmu(files):
    with zipfile.ZipFile(files["2.0"]) as archive:
        names = set(archive.namelist())
        assert "All rights reserved" in archive.read("documentation/licenses/fmi.txt").decode()
        assert b"law: TDC" in archive.read("documentation/index.html")
        assert b'law: "TDC"' in archive.read("resources/law.yaml")
    assert {"sources/law.c", "sources/law.h", "sources/fmi2.c", "sources/fmi2Functions.h"} <= names
    assert not any("python" in name for name in names)


def test_trouble_is_named(tmp_path, monkeypatch):
    file = tmp_path / "law.fmu"
    with pytest.raises(InvalidParameter, match=r"platforms: got 'amiga'; allowed: x86_64-linux"):
        export_fmu(tdc(), file, platforms=["amiga"])
    with pytest.raises(InvalidParameter, match=r"fmi: got '1\.0'"):
        export_fmu(tdc(), file, fmi="1.0")
    with pytest.raises(InvalidParameter, match=r"tunable: got 'speed'; TDC has the numbers .*natural_frequency"):
        export_fmu(tdc(), file, tunable=["speed"])
    law = make_law(tarc.laws.TARC)
    with pytest.raises(UnsupportedLaw, match=r"min_gain of TARC cannot stay changeable: it also sets the state"):
        export_fmu(law, file, tunable=["min_gain"])
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(MissingTool, match="no-such-compiler"):
        export_fmu(tdc(), file, tunable=[])
    monkeypatch.setattr("tarc.core.optional.find_spec", lambda name: None)
    monkeypatch.delitem(sys.modules, "fmpy")
    with pytest.raises(MissingTool, match=r"the export of FMUs needs fmpy; pip install .*\[ship\]'"):
        export_fmu(tdc(), file)
    assert not file.exists()


def test_a_law_that_calls_a_library_is_refused(tmp_path):
    arm = tarc.plants.load_robot("ur5e", armature=0.1, backend="mujoco")
    estimator = tarc.estimators.Algebraic(window=0.010)
    law = tarc.laws.ComputedTorque(model=arm, natural_frequency=10.0, period=PERIOD, estimator=estimator)
    with pytest.raises(UnsupportedLaw):
        export_fmu(law, tmp_path / "law.fmu")


def test_a_library_for_both_kinds_of_mac_has_both():
    parts = {"x86_64-darwin": b"intel" * 5000, "aarch64-darwin": b"arm" * 9}
    content = fmu_platforms.universal(parts)
    assert content[:8] == bytes.fromhex("cafebabe00000002")
    for k, part in enumerate(parts.values()):
        place, size = (int.from_bytes(content[8 + 20 * k + at : 12 + 20 * k + at], "big") for at in (8, 12))
        assert place % 16384 == 0
        assert content[place : place + size] == part


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "fmi"),
    [
        pytest.param(kind, fmi, id=kind.__name__)
        for kind, fmi in zip(concrete_laws(), cycle(["2.0", "3.0"]), strict=False)
    ],
)
def test_every_law_has_its_bits(kind, fmi, tmp_path):
    law = make_law(kind)
    data = recorded(law, count=300)
    written = export_fmu(law, tmp_path / "law.fmu", fmi=fmi)
    assert validate_fmu(str(written.file)) == []
    np.testing.assert_array_equal(co_simulate(Instance(written.file, tmp_path / fmi), data), data.expected)


@pytest.mark.slow
def test_libcosim_gives_the_bits_of_the_controller(files, tmp_path):
    pytest.importorskip("libcosimpy")
    data = recorded()
    script = tmp_path / "run.py"
    np.save(tmp_path / "inputs.npy", data.inputs)
    script.write_text(LIBCOSIM)
    # in a process of its own, since libcosim logs to the standard output and never leaves the process
    command = [sys.executable, str(script), str(files["2.0"]), str(tmp_path)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr[-2000:]
    np.testing.assert_array_equal(np.load(tmp_path / "outputs.npy"), data.expected)


LIBCOSIM = """
import sys
import fmpy
import numpy as np
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

file, folder = sys.argv[1:]
inputs = np.load(f"{folder}/inputs.npy")
references = {one.name: one.valueReference for one in fmpy.read_model_description(file).modelVariables}
names = ("position", "reference", "velocity_reference", "acceleration_reference", "applied_torque")
places = [references[f"{name}[{i}]"] for name in names for i in (1, 2)]
execution = CosimExecution.from_step_size(1_000_000)  # ns
slave = execution.add_local_slave(CosimLocalSlave(file, "law"))
observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
execution.add_observer(observer)
execution.add_manipulator(manipulator)
assert execution.boolean_initial_value(slave, references["uses_applied_torque"], True)
outputs = []
for row in inputs:
    manipulator.slave_real_values(slave, places, row.tolist())
    assert execution.step()
    torque = observer.last_real_values(slave, [references["torque[1]"], references["torque[2]"]])
    outputs.append([*torque, *observer.last_integer_values(slave, [references["missing"]])])
np.save(f"{folder}/outputs.npy", outputs)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fmi", "platforms"), [("2.0", list(fmu_platforms.PLATFORMS)), ("3.0", ["x86_64-linux", "aarch64-linux"])]
)
def test_zig_compiles_for_every_platform(fmi, platforms, tmp_path):
    pytest.importorskip("ziglang")
    data = recorded()
    written = export_fmu(tdc(), tmp_path / "law.fmu", fmi=fmi, platforms=platforms, tunable=[])
    start = {"so": b"\x7fELF", "dll": b"MZ", "dylib": bytes.fromhex("cafebabe" if fmi == "2.0" else "cffaedfe")}
    with zipfile.ZipFile(written.file) as archive:
        for name in written.libraries:
            content = archive.read(name)
            assert content.startswith(start[name.rpartition(".")[2]])
            assert f"fmi{fmi[0]}DoStep".encode() in content
    assert len(written.libraries) == (4 if fmi == "2.0" else 2)
    if fmu_platforms.this_platform() == "x86_64-linux":
        np.testing.assert_array_equal(co_simulate(Instance(written.file, tmp_path / "out"), data), data.expected)
