"""Studies as a whole: results against single runs, resume, folders of others, full disks."""

import errno
import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

import tarc.study.store as store_module
from tarc.core.errors import EngineWarning, InvalidParameter
from tarc.scenario.model import Scenario
from tarc.simulation.integration import Integration
from tarc.study import execution, scheduling
from tarc.study.cases import Cases
from tarc.study.engines import Simulator
from tarc.study.specification import Study
from tarc.study.store import rows_per_chunk
from tarc.study.study_result import StudyResult

SCENARIO = {
    "robot": {"kind": "TwoLinkArm", "viscous": [0.5, 0.5]},
    "law": [
        {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0},
        {"kind": "PID", "inertia": 1.0, "natural_frequency": 12.0},
    ],
    "estimator": {"kind": "Algebraic", "window": 0.010, "degree": 2},
    "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.2], "frequency": 3.0},
    "initial_torque": "rest",
    "duration": 0.12,
    "substeps": 1,
    "metrics_start": 0.03,
}
DRAWS = {
    "robot.payload": {"uniform": [0.0, 3.0]},
    "robot.viscous.0": {"uniform": [0.0, 1.0]},
    "sensor.noise": {"log_uniform": [1e-7, 1e-6]},
}


def study(runs=12, **changes):
    return Study.parse({"scenario": SCENARIO, "draws": DRAWS, "runs": runs, "sampling": "sobol", **changes})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "whole.study"
    return study(traces=[1]).run(folder)


def same(first, second):
    for name in first.data_vars:
        np.testing.assert_array_equal(first[name].values, second[name].values, err_msg=str(name))


def test_a_run_of_a_study_is_the_run_of_its_scenario(finished):
    data = finished.data
    for run in (0, 7):
        row = {key: float(data[f"drawn:{key}"].values[run]) for key in DRAWS}
        laws = [dict(law) for law in SCENARIO["law"]]
        robot = {**SCENARIO["robot"], "payload": row["robot.payload"], "viscous": [row["robot.viscous.0"], 0.5]}
        seed = int(data["seed"].values[run])
        # the laws do not know the payload: M̂ is that of the robot as written
        laws[0]["inertia"] = Cases(study()).nominal.laws["TDC"].inertia.tolist()
        content = {**SCENARIO, "robot": robot, "law": laws, "seed": seed, "sensor": {"noise": row["sensor.noise"]}}
        runs = Scenario.parse(content).run()
        for column, single in enumerate(runs.values()):
            measures = single.metrics(start_time=0.03)
            assert set(measures) <= set(finished.measures)
            for name, value in measures.items():
                assert data[name].values[run, column] == pytest.approx(value, rel=1e-7, abs=1e-12), name


def test_the_dataset_has_all_that_a_reader_needs(finished):
    data = xr.open_zarr(finished.folder / "results.zarr")
    assert set(data.data_vars) == set(finished.data.data_vars)
    assert data.sizes == {"run": 12, "law": 2}
    assert data["law"].values.tolist() == ["TDC", "PID"]
    assert data["run"].values.tolist() == list(range(12))
    assert data["completed"].dtype == bool
    assert data["completed"].values.all()
    np.testing.assert_array_equal(data["end_time"], 0.12)
    for key in DRAWS:
        np.testing.assert_allclose(data[f"applied:{key}"], data[f"drawn:{key}"], rtol=1e-12)
    np.testing.assert_array_equal(data["seed"], study().draw().seeds)
    assert data.attrs["joint_units"] == ["rad"]
    assert Study.load(finished.folder / "study.yaml").content_hash == data.attrs["content_hash"]


def test_trajectories_of_chosen_runs_are_kept(finished):
    assert [path.name for path in finished.traced] == ["1-0.nc", "1-1.nc"]
    run = finished.trace(1, "PID")
    assert run.metrics(start_time=0.03)["rms_error"] == finished.data["rms_error"].values[1, 1]
    with pytest.raises(InvalidParameter, match="no trajectories of run 3"):
        finished.trace(3)


class Interrupted:
    """Stands in for a kill: the writing of a chunk fails from some chunk on."""

    def __init__(self, monkeypatch, error, chunks):
        self.left, self.error, write = chunks, error, store_module.Store._mark

        def mark(store, start, stop):
            self.left -= 1
            if self.left < 0:
                raise self.error
            write(store, start, stop)

        monkeypatch.setattr(store_module.Store, "_mark", mark)


def test_a_killed_study_goes_on_and_runs_nothing_twice(finished, tmp_path, monkeypatch):
    folder = tmp_path / "own.study"
    with monkeypatch.context() as patch:
        Interrupted(patch, KeyboardInterrupt(), 1)
        with pytest.raises(KeyboardInterrupt):
            study().run(folder)
    partial = StudyResult.open(folder)
    assert not partial.is_complete
    assert partial.data["run"].values.tolist() == list(range(8))
    same(partial.data, finished.data.isel(run=slice(0, 8)))
    ran = []
    run = Simulator.run

    def counted(self, indices, values, seeds):
        ran.extend(indices.tolist())
        return run(self, indices, values, seeds)

    monkeypatch.setattr(Simulator, "run", counted)
    result = study().run(folder)
    assert ran == list(range(8, 12))
    assert result.is_complete
    same(result.data, finished.data)
    study().run(folder)
    assert ran == list(range(8, 12))


def test_more_runs_keep_the_first_ones(finished, tmp_path):
    folder = tmp_path / "grown.study"
    shutil.copytree(finished.folder, folder)
    grown = study(runs=18).run(folder)
    assert grown.data["run"].values.tolist() == list(range(18))
    same(grown.data.isel(run=slice(0, 12)), finished.data)
    same(xr.open_zarr(folder / "results.zarr"), grown.data)
    whole = study(runs=18).run(tmp_path / "whole.study")
    same(grown.data, whole.data)
    assert Study.load(folder / "study.yaml").runs == 18


def test_fewer_runs_than_a_stopped_study_has(finished, tmp_path, monkeypatch):
    folder = tmp_path / "own.study"
    with monkeypatch.context() as patch:
        Interrupted(patch, KeyboardInterrupt(), 1)
        with pytest.raises(KeyboardInterrupt):
            study().run(folder, jobs=1)
    fewer = study(runs=10).run(folder, jobs=1)
    assert fewer.data["run"].values.tolist() == list(range(10))
    same(fewer.data, finished.data.isel(run=slice(0, 10)))
    assert study().run(folder, jobs=1).is_complete


def test_a_full_disk_keeps_what_is_there_and_says_how_to_go_on(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        Interrupted(patch, OSError(errno.ENOSPC, "No space left on device"), 1)
        with pytest.raises(InvalidParameter, match=r"No space left on device; 8 of 12 runs are kept. To go on, free"):
            study().run(tmp_path / "own.study")
    assert study().run(tmp_path / "own.study").is_complete


@pytest.mark.parametrize("change", [{"seed": 5}, {"draws": {"robot.payload": {"uniform": [0.0, 2.0]}}}])
def test_the_folder_of_another_study_is_refused(finished, change):
    with pytest.raises(
        InvalidParameter, match=r"has another study in it \(see its study.yaml\).*choose another folder"
    ):
        study(**change).run(finished.folder)


def test_the_folder_of_another_version_is_refused(finished, monkeypatch):
    monkeypatch.setattr(store_module, "__version__", "9.9")
    with pytest.raises(InvalidParameter, match=r"was written by tarc-control .*, and this is tarc-control 9.9"):
        study().run(finished.folder)


def test_the_folder_of_another_layout_is_refused(finished, monkeypatch):
    monkeypatch.setattr(store_module, "LAYOUT", 99)
    with pytest.raises(InvalidParameter, match=r"has the layout \d+, and this version reads 99; choose another folder"):
        study().run(finished.folder)
    with pytest.raises(InvalidParameter, match=r"has the layout"):
        StudyResult.open(finished.folder)


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("", encoding="utf-8")
    with pytest.raises(InvalidParameter, match=r"has files in it and no study; choose a folder"):
        study().run(tmp_path)
    with pytest.raises(InvalidParameter, match=r"has no results.zarr; needs the folder that `tarc study` wrote"):
        StudyResult.open(tmp_path)


def test_two_processes_do_not_write_one_folder(finished):
    with store_module.open_store(finished.folder, study()), pytest.raises(InvalidParameter, match=r"another process"):
        study().run(finished.folder)


def test_results_do_not_depend_on_how_runs_are_cut_into_chunks():
    own = study(runs=6)
    draws, method = own.draw(), Integration("midpoint", 1)
    whole = Simulator(Cases(own), method).run(np.arange(6), draws.values, draws.seeds)
    for start, stop in ((0, 1), (1, 4), (4, 6)):
        part = Simulator(Cases(own), method).run(
            np.arange(start, stop), draws.values[start:stop], draws.seeds[start:stop]
        )
        np.testing.assert_array_equal(part.end_time, whole.end_time[start:stop])
        for name, values in part.measures.items():
            np.testing.assert_array_equal(values, whole.measures[name][start:stop])


def test_a_diverged_run_is_a_result_with_its_time(tmp_path):
    law = {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0}
    unstable = study(
        runs=8,
        scenario={**SCENARIO, "divergence_threshold": 0.05, "metrics_start": 0.06, "law": law},
        draws={"law.inertia.fraction": {"choice": [0.08, 3.0]}},
        sampling="latin_hypercube",
    )
    data = unstable.run(tmp_path / "unstable.study").data
    is_large = data["drawn:law.inertia.fraction"].values == 3.0
    assert is_large.sum() == 4
    np.testing.assert_array_equal(data["completed"].values[:, 0], ~is_large)
    ends = data["end_time"].values[:, 0]
    assert np.all((ends[is_large] > 0) & (ends[is_large] < 0.06))
    assert np.all(np.isnan(data["rms_error"].values[is_large]))
    assert np.all(np.isfinite(data["rms_error"].values[~is_large]))
    low, high = StudyResult.open(tmp_path / "unstable.study").quantiles("rms_error", [0.5, 0.6])["TDC"]
    assert (low, high) == (data["rms_error"].values[~is_large].max(), np.inf)


def test_an_engine_that_does_not_suit_the_robot_is_refused(tmp_path):
    with pytest.raises(InvalidParameter, match=r"engine: got 'MuJoCo'; the robot is simulated by virtual machine"):
        study().run(tmp_path / "own.study", engine="MuJoCo")
    with pytest.raises(InvalidParameter, match=r"engine: got 'abacus'; known are auto"):
        study().run(tmp_path / "own.study", engine="abacus")


def test_chunks_are_eight_times_a_power_of_two_and_few():
    assert [rows_per_chunk(runs) for runs in (1, 512, 513, 10_000, 1_000_000)] == [8, 8, 16, 256, 16384]


def test_success_rates_and_quantiles(finished):
    assert finished.success_rate == {"TDC": 1.0, "PID": 1.0}
    low, high = finished.quantiles("rms_error", [0.0, 1.0])["PID"]
    values = finished.data["rms_error"].values[:, 1]
    assert (low, high) == (values.min(), values.max())
    with pytest.raises(InvalidParameter, match=r"measure: got 'rms_eror'; .*Did you mean 'rms_error'"):
        finished.quantiles("rms_eror", [0.5])


def test_attributes_are_plain_data(finished):
    json.dumps(finished.data.attrs)


def test_a_study_goes_on_with_the_engine_that_has_begun(tmp_path, monkeypatch):
    folder = tmp_path / "own.study"
    with monkeypatch.context() as patch:
        Interrupted(patch, KeyboardInterrupt(), 1)
        with pytest.raises(KeyboardInterrupt):
            study().run(folder, jobs=1)
    monkeypatch.setattr(execution, "SHORT_STUDY", 0)  # a study so long would run in machine code from the start
    monkeypatch.setattr(execution, "LONG_REMAINDER", 0)
    with pytest.warns(EngineWarning, match="goes on in the virtual machine, which has begun it"):
        data = study().run(folder, jobs=1).data
    assert data.attrs["engines"] == {"TDC": "virtual machine", "PID": "virtual machine"}


@pytest.mark.parametrize("damage", ["marks", "attributes", "hole"])
def test_a_damaged_folder_is_run_again_or_refused(finished, tmp_path, damage):
    folder = tmp_path / "damaged.study"
    shutil.copytree(finished.folder, folder)
    if damage == "attributes":
        (folder / "results.zarr" / ".zattrs").write_text("{}", encoding="utf-8")
        with pytest.raises(InvalidParameter, match=r"lacks the attributes runs, chunk, .*begin anew"):
            study().run(folder)
        return
    if damage == "marks":
        shutil.rmtree(folder / "done")
    else:
        (folder / "done" / "00000000-00000008").rename(folder / "done" / "00000002-00000005")
    result = study().run(folder, jobs=1)
    same(result.data, finished.data)


@pytest.mark.slow
def test_a_process_that_is_killed_and_several_processes_give_the_same_bits(tmp_path, monkeypatch):
    content = {"scenario": SCENARIO, "draws": DRAWS, "runs": 120, "sampling": "latin_hypercube"}
    code = f"""
import os, signal
from pathlib import Path
from tarc.study import Study
from tarc.study.store import Store

mark = Store._mark

def killing_mark(store, start, stop):
    mark(store, start, stop)
    if len(list(Path("killed.study/done").iterdir())) == 4:
        os.kill(os.getpid(), signal.SIGKILL)

Store._mark = killing_mark
Study.parse({content!r}).run("killed.study", jobs=1)
"""
    folder = tmp_path / "killed.study"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    assert done.returncode == -signal.SIGKILL
    own = Study.parse(content)
    begun = StudyResult.open(folder).data.sizes["run"]
    assert 0 < begun < 120
    killed = own.run(folder, jobs=1)
    whole = own.run(tmp_path / "whole.study", jobs=1)
    monkeypatch.setattr(scheduling, "SERIAL_TIME", 0.0)  # so short a study would stay in one process
    parallel = own.run(tmp_path / "parallel.study", jobs=2)
    same(killed.data, whole.data)
    same(parallel.data, whole.data)


@pytest.mark.slow
def test_a_robot_in_mujoco_is_drawn_too(tmp_path):
    content = Scenario.load("ur5e_load", ["duration=0.1", "metrics_start=0.02"]).model_dump(exclude_defaults=True)
    content["robot"]["backend"] = "mujoco"
    own = Study.parse({"scenario": content, "runs": 8, "draws": {"robot.coulomb.1": {"uniform": [1.0, 4.0]}}})
    data = own.run(tmp_path / "ur5e.study", jobs=1).data
    assert data.attrs["engines"] == {"TDC": "MuJoCo"}
    np.testing.assert_array_equal(data["applied:robot.coulomb.1"], data["drawn:robot.coulomb.1"])
    assert len(set(data["rms_error"].values[:, 0])) == 8


def test_a_value_that_a_part_refuses_is_found_before_the_first_run(tmp_path):
    negative = {"sensor.noise": {"normal": {"mean": 1e-6, "deviation": 1e-6}}}
    with pytest.raises(InvalidParameter, match=r"sensor.noise: got -"):
        study(200, draws=negative).run(tmp_path / "own.study", jobs=1)
    assert StudyResult.open(tmp_path / "own.study").data.sizes["run"] == 0


def test_another_number_of_runs_of_a_latin_hypercube_says_why_it_is_refused(tmp_path):
    folder = tmp_path / "own.study"
    study(8, sampling="latin_hypercube").run(folder, jobs=1)
    with pytest.raises(InvalidParameter, match=r"this study with 8 runs, and a Latin hypercube of 9 has other draws"):
        study(9, sampling="latin_hypercube").run(folder, jobs=1)


def test_many_more_runs_are_stored_in_larger_chunks(finished, tmp_path, monkeypatch):
    folder = tmp_path / "grown.study"
    shutil.copytree(finished.folder, folder)
    monkeypatch.setattr(store_module, "MAX_CHUNKS", 1)
    grown = study(runs=19).run(folder, jobs=1)
    assert grown.data.attrs["chunk"] == 32
    assert xr.open_zarr(folder / "results.zarr")["rms_error"].encoding["chunks"] == (32, 2)
    same(grown.data.isel(run=slice(0, 12)), finished.data)
    assert sorted(path.name for path in (folder / "done").iterdir())[-1] == "00000012-00000019"
    assert not list(folder.glob(".results*"))
    # a kill between the two steps of the swap leaves the former dataset, and one before them a partial one
    (folder / "results.zarr").rename(folder / ".results.zarr.old")
    (folder / ".results.zarr.part").mkdir()
    same(study(runs=19).run(folder, jobs=1).data, grown.data)


def test_a_kill_while_the_folder_is_made_is_no_harm(finished, tmp_path):
    folder = tmp_path / "own.study"
    (folder / ".results.zarr.part").mkdir(parents=True)
    same(study().run(folder, jobs=1).data, finished.data)
