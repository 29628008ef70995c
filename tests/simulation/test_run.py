"""Runs: measures by their definitions, status, saving."""

import json

import numpy as np
import pytest
import xarray as xr
from scipy.interpolate import CubicHermiteSpline

from tarc import Run, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.plants import Pendulum


def run_by_hand(error, torque, gain=None, sliding=None, limit=np.inf, diverged=np.nan, period=0.01):
    """Return a run put together by hand."""
    count = len(error)
    variables = {
        "position": (("time", "joint"), np.asarray(error) + 1.0, {"units": "rad"}),
        "reference": (("time", "joint"), np.ones_like(error), {"units": "rad"}),
        "torque": (("time", "joint"), np.asarray(torque), {"units": "N m"}),
    }
    if gain is not None:
        variables |= {"gain": ("time", gain, {"units": "rad/s²"}), "sliding": ("time", sliding)}
    joints = [f"joint{i + 1}" for i in range(np.shape(error)[1])]
    variables["torque_limit"] = ("joint", np.full(len(joints), limit))
    attrs = {"period": period, "divergence_time": diverged, "title": "X on Y"}
    return Run(xr.Dataset(variables, {"time": np.arange(count) * period, "joint": joints}, attrs))


def test_errors_and_variation_by_hand():
    error = np.array([[3.0, 4.0], [0.0, 0.0], [0.0, 0.0], [1.0, 2.0]])
    torque = np.array([[0.0, 0.0], [1.0, -2.0], [0.0, 0.0], [4.0, 0.0]])
    metrics = run_by_hand(error, torque, limit=2.0).metrics()
    assert metrics["rms_error"] == pytest.approx(np.sqrt(30 / 8))
    assert metrics["peak_error"] == 4.0
    assert metrics["torque_variation"] == pytest.approx((3 + 3 + 4) / 0.03)
    assert metrics["peak_torque"] == 4.0
    assert metrics["saturated"] == 2 / 8
    assert run_by_hand(error, torque).metrics(start_time=0.01)["rms_error"] == pytest.approx(np.sqrt(5 / 6))


def test_high_frequency_share_is_parsevals():
    """Two sines at 10 and 100 Hz with amplitudes 3 and 1: a tenth of the energy is above 50 Hz."""
    t = np.arange(1000) * 1e-3
    torque = (5.0 + 3 * np.sin(2 * np.pi * 10 * t) + np.sin(2 * np.pi * 100 * t))[:, None]
    assert run_by_hand(0 * torque, torque, period=1e-3).metrics()["high_frequency_share"] == pytest.approx(
        0.1, abs=1e-9
    )


def test_over_and_underestimation_by_hand():
    gain = np.array([1.0, 2.0, 3.0, 2.0, 1.0, 1.0])
    sliding = np.array([5.0, 6.0, 5.0, 4.0, 7.0, 8.0])  # up, down, down, up, up
    zero = np.zeros((6, 1))
    metrics = run_by_hand(zero, zero, gain, sliding).metrics()
    assert metrics["overestimation"] == 1 / 5
    assert metrics["underestimation"] == 1 / 5


def triangle(count, shift=0):
    """Up from 0 to 1 and down again every 400 samples."""
    return 1 - np.abs((np.arange(count) + shift) % 400 / 200 - 1)


@pytest.mark.parametrize(("shift", "share"), [(0, 0.0), (50, 0.125), (100, 0.25), (200, 0.5)])
def test_smoothing_finds_the_share_under_noise(shift, share):
    """Two triangles an eighth of a period apart go opposite ways for a quarter of the time, half of it each way."""
    count = 40_000
    noise = 0.02 * np.random.default_rng(0).standard_normal(count)  # four times what the gain moves in a sample
    run = run_by_hand(np.zeros((count, 1)), np.zeros((count, 1)), 5 + triangle(count) + noise, triangle(count, shift))
    plain, smooth = run.metrics(), run.metrics(averaging_time=0.4)
    for name in ("overestimation", "underestimation"):
        assert plain[name] == pytest.approx(0.25, abs=0.04), "noise decides, whatever the share"
        assert smooth[name] == pytest.approx(share, abs=0.02)


def test_smoothing_is_a_moving_average():
    gain, sliding = np.random.default_rng(1).standard_normal((2, 200))
    zero = np.zeros((200, 1))
    change, growth = (np.diff(np.convolve(x, np.ones(7) / 7, "valid")) for x in (gain, sliding))
    metrics = run_by_hand(zero, zero, gain, sliding).metrics(averaging_time=0.07)
    assert metrics["overestimation"] == np.mean((change > 0) & (growth < 0))
    assert metrics["underestimation"] == np.mean((change < 0) & (growth > 0))


def test_a_gain_that_chatters_at_its_floor_counts_as_still():
    gain, sliding = np.tile([1.0, 1.001], 50), np.linspace(0.0, 1.0, 100)
    run = run_by_hand(np.zeros((100, 1)), np.zeros((100, 1)), gain, sliding)
    assert run.metrics()["underestimation"] == pytest.approx(0.5, abs=0.01)
    assert run.metrics(averaging_time=0.1)["underestimation"] == 0


@pytest.mark.parametrize(
    ("smooth", "message"),
    [
        (-0.1, "averaging_time: got -0.1; needs a finite number of at least 0"),
        (0.015, r"averaging_time: got 0.015 s, which is no whole multiple of the period 0.01 s"),
        (1.0, "averaging_time: got 1 s; the measured part of the run lasts 1 s, use less"),
        (None, "averaging_time: got None"),
    ],
)
def test_bad_smoothing_is_refused(smooth, message):
    zero = np.zeros((100, 1))
    with pytest.raises(InvalidParameter, match=message):
        run_by_hand(zero, zero, zero[:, 0], zero[:, 0]).metrics(averaging_time=smooth)


def pendulum_law(inertia=0.05, **options):
    return laws.TDC(
        inertia=inertia, natural_frequency=10.0, period=1e-3, estimator=estimators.Algebraic(window=0.01), **options
    )


REFERENCE = signals.Sinusoid(amplitude=[0.5], frequency=3.0)


def test_divergence_ends_early_with_status():
    run = simulate(Pendulum(), pendulum_law(3.0), REFERENCE, 5.0)
    assert not run.status.completed
    assert run.data.sizes["time"] < 5000
    assert str(run.status).startswith(f"diverged at {run.status.divergence_time:.3f} s")
    assert np.all(np.isfinite(run.data["torque"]))
    with pytest.raises(InvalidParameter, match=r"start_time: got 4 s; the run ends at .* \(diverged at"):
        run.metrics(start_time=4.0)


@pytest.mark.parametrize("plant", ["symbolic", "mujoco"])
def test_divergence_in_both_engines(plant, tmp_path):
    (tmp_path / "p.xml").write_text(
        "<mujoco><worldbody><body><joint name='j' axis='0 1 0'/><inertial pos='0 0 -1' mass='1' "
        "diaginertia='1e-6 1e-6 1e-6'/></body></worldbody></mujoco>"
    )
    robot = Pendulum() if plant == "symbolic" else plants.MujocoPlant.from_file(tmp_path / "p.xml")
    run = simulate(robot, pendulum_law(3.0), REFERENCE, 2.0, divergence_threshold=50.0)
    assert run.status.divergence_time is not None
    assert np.all(np.abs(run.data["position"] - run.data["reference"]) <= 50.0)


def test_saturation_share_and_fault():
    run = simulate(Pendulum(), pendulum_law(torque_limit=2.0), REFERENCE, 1.0)
    assert 0 < run.status.saturated < 1
    assert np.max(np.abs(run.data["torque"])) == 2.0
    lost = simulate(Pendulum(), pendulum_law(max_missing=0), REFERENCE, 1.0, sensor=signals.Encoder(dropout=0.01))
    assert lost.status.fault_time is not None
    assert "safe torque from" in str(lost.status)
    after = lost.data.sel(time=slice(lost.status.fault_time, None))
    assert np.all(after["torque"] == 0)


def test_tde_error_is_acceleration_minus_u():
    """From the recorded motion: the velocity gained over a period is T (u + TDE error) to first order in T."""
    run = simulate(Pendulum(viscous=0.5), pendulum_law(), REFERENCE, 1.0)
    velocity, u, error = (run.data[name].values[:, 0] for name in ("velocity", "auxiliary", "tde_error"))
    gained = np.diff(velocity) / 1e-3
    np.testing.assert_allclose((u + error)[:-1], gained, atol=0.1 * np.max(np.abs(gained)))
    smooth = slice(100, None)  # after the start, over one period the acceleration changes by well under 1 %
    np.testing.assert_allclose((u + error)[:-1][smooth], gained[smooth], atol=0.02 * np.max(np.abs(gained[smooth])))


def test_save_and_load(tmp_path):
    run = simulate(Pendulum(), pendulum_law(), REFERENCE, 0.5, sensor=signals.Encoder(bits=12), seed=4)
    again = Run.load(run.save(tmp_path / "run.nc"))
    xr.testing.assert_identical(run.data, again.data)
    assert str(again.status) == str(run.status)
    with pytest.raises(InvalidParameter, match=r"save: got '.*nodir/x.nc'; the folder .*nodir does not exist"):
        run.save(tmp_path / "nodir" / "x.nc")
    assert not (tmp_path / "nodir").exists()
    with pytest.raises(InvalidParameter, match="load: no file"):
        Run.load(tmp_path / "none.nc")
    (tmp_path / "bad.nc").write_text("no netCDF")
    with pytest.raises(InvalidParameter, match="is no netCDF file"):
        Run.load(tmp_path / "bad.nc")


def test_failed_save_keeps_the_old_file(tmp_path, monkeypatch):
    run = simulate(Pendulum(), pendulum_law(), REFERENCE, 0.1)
    target = run.save(tmp_path / "run.nc")
    before = target.read_bytes()

    def full(self, path, **_):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full)
    with pytest.raises(InvalidParameter, match="save: cannot write .*: No space left on device"):
        run.save(target)
    assert target.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["run.nc"]


def test_same_seed_same_run():
    sensor = signals.Encoder(bits=14, noise=1e-4, dropout=0.01)
    runs = [simulate(Pendulum(), pendulum_law(), REFERENCE, 0.3, sensor=sensor, seed=seed) for seed in (1, 1, 2)]
    xr.testing.assert_identical(runs[0].data, runs[1].data)
    assert not np.array_equal(runs[0].data["torque"], runs[2].data["torque"])


def test_computation_delay_holds_the_torque_back():
    """With a delay of d periods the joints get the law's torque d periods later."""
    run = simulate(Pendulum(), pendulum_law(), REFERENCE, 0.05, computation_delay=3, initial_torque=1.5)
    np.testing.assert_array_equal(run.data["torque"].values[:3], 1.5)
    assert run.data["torque"].values[3] != 1.5


def test_figures_draw(tmp_path):
    run = simulate(Pendulum(), pendulum_law(), REFERENCE, 0.5)
    for style in ("screen", "column"):
        run.plot(style, others={"again": run}).savefig(tmp_path / f"{style}.png")
    assert run.plot(style="column").get_figwidth() == 3.5
    with pytest.raises(InvalidParameter, match="style: got 'poster'; known are screen, column"):
        run.plot("poster")


def test_a_run_says_what_it_is():
    run = simulate(Pendulum(), pendulum_law(), REFERENCE, 0.5)
    rms = 1e3 * run.metrics()["rms_error"]
    assert repr(run) == f"<Run of TDC on Pendulum: 500 samples, completed, RMS error {rms:.4g} mrad>"
    html = run._repr_html_()
    assert "<b>TDC on Pendulum</b>, 500 samples, completed" in html
    assert f"<td>RMS error</td><td>{rms:.4g}</td><td>mrad</td>" in html
    lost = simulate(Pendulum(), pendulum_law(3.0), REFERENCE, 5.0)
    assert f"diverged at {lost.status.divergence_time:.3f} s" in repr(lost)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "duration: got 0"),
        ({"substeps": 0}, "substeps: got 0; needs a whole number of at least 1"),
        ({"computation_delay": -1}, "computation_delay: got -1"),
        ({"initial_position": [1.0, 2.0]}, r"initial_position: got shape \(2,\)"),
        ({"initial_torque": "brake"}, "initial_torque: got 'brake'; known are rest"),
        ({"disturbance": 3.0}, "disturbance: got 3.0; needs a Disturbance"),
        ({"law": laws.TDC}, "law: got .*constructed"),
        ({"plant": "ur5e"}, "plant: got 'ur5e'"),
        ({"reference": lambda t: t}, "reference: got"),
        ({"reference": signals.Sinusoid(amplitude=[1.0, 1.0], frequency=1.0)}, "joints: the plant has 1, the law 1"),
    ],
)
def test_bad_arguments(options, message):
    given = {"plant": Pendulum(), "law": pendulum_law(), "reference": REFERENCE, "duration": 0.1, **options}
    with pytest.raises(InvalidParameter, match=message):
        simulate(**given)


def two_joint_file(path, limits=("", ""), kinds=("hinge", "hinge")):
    joints = [f"<joint type='{k}' axis='0 0 1' {limit}/>" for k, limit in zip(kinds, limits, strict=True)]
    inertial = "<inertial pos='0.1 0 0' mass='1' diaginertia='0.1 0.1 0.1'/>"
    first, second = (joint.replace("<joint", f"<joint name='{i}'") for i, joint in enumerate(joints))
    inner = f"<body>{second}{inertial}</body>"
    path.write_text(f"<mujoco><worldbody><body>{first}{inertial}{inner}</body></worldbody></mujoco>")
    return plants.MujocoPlant.from_file(path)


def two_joint_run(robot, **options):
    law = laws.TDC(
        inertia=[0.02, 0.02],
        natural_frequency=20.0,
        period=1e-3,
        estimator=estimators.Algebraic(window=0.01),
        **options,
    )
    return simulate(robot, law, signals.Sinusoid(amplitude=[1.0, 1.0], frequency=9.0), 0.5)


def test_a_limit_on_one_joint_of_two_holds(tmp_path):
    robot = two_joint_file(tmp_path / "r.xml", limits=("actuatorfrcrange='-0.5 0.5'", ""))
    assert robot.torque_limits.tolist() == [0.5, np.inf]
    run = two_joint_run(robot)
    peak = np.abs(run.data["torque"].values).max(axis=0)
    assert peak[0] == 0.5
    assert peak[1] > 0.5
    assert run.data["torque_limit"].values.tolist() == [0.5, np.inf]


def test_units_follow_the_joints(tmp_path):
    mixed = two_joint_run(two_joint_file(tmp_path / "m.xml", kinds=("hinge", "slide")))
    assert mixed.data["velocity"].attrs["units"] == "(rad or m)/s"
    assert mixed.data["torque"].attrs["units"] == "N m or N"
    slides = two_joint_run(two_joint_file(tmp_path / "s.xml", kinds=("slide", "slide")))
    assert (slides.data["position"].attrs["units"], slides.data["torque"].attrs["units"]) == ("m", "N")


def test_chatter_at_every_sample_counts_by_its_energy():
    """A sine of energy 1/2 and a torque that alternates ±1, energy 1: two thirds are above 50 Hz, at any length."""
    for count in (2000, 1999):
        k = np.arange(count)
        torque = np.sin(2 * np.pi * k / 1000)[:, None] + (-1.0) ** k[:, None]
        share = run_by_hand(0 * torque, torque, period=1e-3).metrics()["high_frequency_share"]
        assert share == pytest.approx(2 / 3, abs=2e-3)


def test_a_fault_stops_the_gain_and_the_tde_error():
    law = laws.TARC(
        inertia=0.05,
        natural_frequency=10.0,
        period=1e-3,
        estimator=estimators.Algebraic(window=0.01),
        max_missing=0,
        rise_rate=2000.0,
        fall_rate=1000.0,
    )
    run = simulate(Pendulum(), law, REFERENCE, 1.0, sensor=signals.Encoder(dropout=0.02))
    start_time = run.status.fault_time
    assert start_time is not None
    after = run.data.sel(time=slice(start_time, None))
    assert np.ptp(after["gain"].values[1:]) == 0
    assert np.all(np.isnan(after["tde_error"]))
    assert np.isfinite(run.metrics()["rms_tde_error"])


def test_numpy_numbers_are_described_and_saved(tmp_path):
    law = pendulum_law(float(np.float32(0.05)), max_missing=np.int64(3), torque_limit=[np.inf])
    run = simulate(
        Pendulum(),
        law,
        REFERENCE,
        0.1,
        sensor=signals.Encoder(bits=np.int64(12)),  # type: ignore[arg-type] - the test's subject
        disturbance=signals.ParameterSchedule(parameter="payload", times=range(1), values=[np.array([1.0])]),
    )
    assert json.loads(Run.load(run.save(tmp_path / "a.nc")).data.attrs["law"])["max_missing"] == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed: got -1; needs a whole number"),
        ({"seed": "a"}, "seed: got 'a'"),
        ({"sensor": signals.Encoder}, "sensor: got .*constructed"),
        ({"sensor": signals.Encoder(resolution=[0.1, 0.1])}, "sensor: its resolution has 2 numbers"),
        ({"duration": 1e9}, "duration: got 1e.09; needs a finite number"),
        (
            {"disturbance": signals.ParameterSchedule(parameter="mass", times=[0.0], values=[-1.0])},
            "mass: got -1; needs a finite number above 0",
        ),
    ],
)
def test_more_bad_arguments(options, message):
    given = {"plant": Pendulum(), "law": pendulum_law(), "reference": REFERENCE, "duration": 0.1, **options}
    with pytest.raises(InvalidParameter, match=message):
        simulate(**given)


class BarePlant(plants.Plant):
    """One joint by its matrices alone, which nothing integrates."""

    @property
    def n_joints(self):
        return 1

    @property
    def parameters(self):
        return {}

    def inertia(self, position):
        return np.eye(1)

    def gravity_torque(self, position):
        return np.zeros(1)

    def with_parameters(self, values):
        return self

    def bias(self, position, velocity):
        return np.zeros(1)


def test_a_plant_that_cannot_be_integrated_is_refused():
    with pytest.raises(InvalidParameter, match="plant: got .*; only a robot from energies .* or from a file"):
        simulate(BarePlant(), pendulum_law(), REFERENCE, 0.1)


def test_columns_of_a_record_drive_the_joints_of_their_names(tmp_path):
    times = np.arange(0, 1, 0.02)
    table = np.column_stack([1.7e9 + times, 0.9 + 0 * times, 0.1 + 0 * times])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="stamp,joint2,joint1", comments="", fmt="%.6f")
    law = laws.TDC(
        inertia=[0.15, 0.05], natural_frequency=10.0, period=1e-3, estimator=estimators.Algebraic(window=0.01)
    )
    reference = signals.RecordedReference(path=tmp_path / "a.csv")
    run = simulate(plants.TwoLinkArm(), law, reference, 0.2, initial_torque="rest")
    np.testing.assert_allclose(run.data["position"].values[0], [0.1, 0.9])
    np.testing.assert_allclose(run.data["reference"].values[-1], [0.1, 0.9])
    stamps = signals.RecordedReference(path=tmp_path / "a.csv", starts_at_zero=False)
    with pytest.raises(InvalidParameter, match="do not overlap"):
        simulate(plants.TwoLinkArm(), law, stamps, 0.2)


@pytest.mark.parametrize("backend", ["symbolic", "mujoco"])
@pytest.mark.parametrize("fraction", [0.3, 0.8])
def test_the_age_of_a_sample_counts_from_the_true_motion(backend: str, fraction: float) -> None:
    """The reading is the position of the simulated motion between two instants, in symbols and in MuJoCo alike."""
    arm = plants.load_robot("ur5e", joints=["shoulder_pan_joint"], armature=0.1, backend=backend)
    sensor = signals.Encoder(delay=1 + fraction)
    run = simulate(arm, pendulum_law(), REFERENCE, 0.3, sensor=sensor, initial_torque="rest").data
    time, period = run["time"].values, run.attrs["period"]
    motion = CubicHermiteSpline(time, run["position"].values[:, 0], run["velocity"].values[:, 0])
    expected = motion(time - (1 + fraction) * period)
    error = run["measured_position"].values[3:, 0] - expected[3:]
    assert np.max(np.abs(error)) < 1e-13
