"""Records of real robots, replayed: ``python -m benchmarks.real_robots``.

The records are no part of the project. They are looked for in ``shared/data`` beside it, or in the folder that the
variable TARC_ROBOT_DATA names. Where they are missing, the command says so and does nothing.
"""

import os
import textwrap
from functools import cache
from pathlib import Path

import numpy as np

import tarc
from benchmarks.page_values.registry import DataMissingError, Value, table, text_block
from tarc.core.errors import NotIdentifiable
from tarc.logs.least_squares import Interval
from tarc.logs.model_check import check_delay_estimation
from tarc.signals import LogColumns, read_log

ROOT = Path(__file__).resolve().parents[1]
KUKA = LogColumns(
    time="rec.time_cont",
    position="rec.act_pos_mot_deg",
    velocity="rec.act_vel_mot_deg_per_s",
    torque="rec.act_torque_abs_nm",
    units={"position": "deg", "velocity": "deg/s"},
)
LINK_JOINTS = 3
"""Joints of the KUKA with an encoder at the link."""
PANDA = LogColumns(
    time="exciting_traj_time.txt",
    position="exciting_traj_positions.txt",
    velocity="exciting_traj_velocity.txt",
    torque="exciting_traj_torques.txt",
)
PANDA_PART = 2.2, 19.6
"""Part of the Panda's record without its start and end [s]."""
CUTOFFS = (10.0, 20.0, 30.0, 40.0)
"""Frequencies below which the torque counts as true [Hz]."""
KUKA_RUNS = ("A", "B", "C")
KUKA_WINDOWS = (0.012, 0.020, 0.040)
"""[s]"""


def data_folder() -> Path:
    """Return the folder of the records.

    Raises
    ------
    DataMissingError
        Where there is none.
    """
    named = os.environ.get("TARC_ROBOT_DATA")
    places = [Path(named)] if named else [folder / "shared" / "data" for folder in (ROOT.parent,)]
    for place in places:
        if (place / "panda").is_dir() and (place / "kuka_kr300").is_dir():
            return place
    raise DataMissingError(f"no records of real robots in {', '.join(map(str, places))}; set TARC_ROBOT_DATA")


@cache
def panda(whole: bool = True) -> tarc.Replay:
    """Return the replay of the Panda's record, all of it or the part without start and end."""
    start, stop = (None, None) if whole else PANDA_PART
    return tarc.replay(data_folder() / "panda", "panda", columns=PANDA, window=0.010, start_time=start, stop_time=stop)


@cache
def kuka(run: str) -> tarc.Replay:
    """Return the replay of a run of the KUKA, by its motor encoders."""
    return tarc.replay(data_folder() / "kuka_kr300" / f"data_{run}.mat", columns=KUKA, window=KUKA_WINDOWS)


@cache
def kuka_links(run: str) -> tarc.Replay:
    """Return the replay of a run of the KUKA, by the encoders at the links of joints 1 to 3."""
    columns = LogColumns(
        time=KUKA.time,
        position="rec.act_pos_se_deg",
        velocity="rec.act_vel_se_deg_per_s",
        units=KUKA.units,
    )
    log = read_log(data_folder() / "kuka_kr300" / f"data_{run}.mat", columns)
    joints = slice(0, LINK_JOINTS)
    links = tarc.signals.RobotLog(
        times=log.times,
        position=log.position[:, joints],
        velocity=None if log.velocity is None else log.velocity[:, joints],
        label=log.label,
    )
    return tarc.replay(links, window=KUKA_WINDOWS[-1])


def timing_table() -> str:
    """Return the timing of both records."""
    shown = {"KUKA KR300": kuka("A").timing, "Franka Panda": panda().timing}
    rows = [
        ["period of the robot [ms]", *(f"{1e3 * timing.period:g}" for timing in shown.values())],
        ["samples per second", *(f"{timing.rate:.1f}" for timing in shown.values())],
        ["steps of the stamps, deviation [ms]", *(f"{1e3 * timing.step_deviation:.3f}" for timing in shown.values())],
        ["stamps off the motion, RMS [ms]", *(f"{1e3 * timing.stamp_error:.3f}" for timing in shown.values())],
        ["stale rows", *(f"{timing.stale:.1%}" for timing in shown.values())],
        ["missing periods", *(f"{timing.missing:.1%}" for timing in shown.values())],
        ["residual on stamps, worst joint [µrad]", *(_micro(timing.residual_before) for timing in shown.values())],
        ["residual on repaired times [µrad]", *(_micro(timing.residual) for timing in shown.values())],
    ]
    return table(["", *shown], rows)


def _micro(values: np.ndarray) -> str:
    return f"{1e6 * np.max(values):.2f}"


def delay_table() -> str:
    """Return the measured delays of each window on the KUKA, least and largest of three runs and six joints."""
    rows = []
    for k, window in enumerate(KUKA_WINDOWS):
        checks = [kuka(run).windows[k] for run in KUKA_RUNS]
        by_motion = 1e3 * np.concatenate([check.delay for check in checks])
        by_velocity = 1e3 * np.concatenate(
            [check.delay_by_velocity for check in checks if check.delay_by_velocity is not None]
        )
        rows.append(
            [
                f"{1e3 * window:g}",
                f"{1e3 * checks[0].predicted_delay:.2f}",
                *(f"{np.min(delays):.2f} – {np.max(delays):.2f}" for delays in (by_motion, by_velocity)),
            ]
        )
    return table(["window [ms]", "predicted [ms]", "against the motion [ms]", "against the velocity [ms]"], rows)


def joint_table() -> str:
    """Return torque and time-delay estimation of the Panda, one column per joint."""
    found, left, part = panda(), panda().delay_estimation, panda(whole=False)
    assert found.model is not None
    assert part.model is not None
    assert left is not None
    check = found.windows[0]
    rows = [
        ["noise of the positions [µrad]", *(f"{1e6 * value:.1f}" for value in found.record.position_noise())],
        ["error of q̈, stamped rows [rad/s²]", *(f"{value:.0f}" for value in check.error_of_stamps)],
        ["error of q̈, repaired times", *(f"{value:.3f}" for value in check.error)],
        ["the same without the delay", *(f"{value:.3f}" for value in check.error_without_delay)],
        ["predicted from the noise", *(f"{value:.3f}" for value in check.noise)],
        ["torque explained, all", *(f"{value:.3f}" for value in found.model.explained)],
        ["torque explained, 2.2 to 19.6 s", *(f"{value:.3f}" for value in part.model.explained)],
        ["TDE leaves, synchronised", *(f"{value:.1%}" for value in left.synchronised)],
        ["TDE leaves, literal", *(f"{value:.1%}" for value in left.literal)],
    ]
    return table(["joint", *(f"{i + 1}" for i in range(found.log.n_joints))], rows)


@cache
def identified(links: bool) -> tarc.IdentifiedModel:
    """Return the Panda as its record shows it, with the links of the file or with links of its own."""
    return tarc.identify_model(data_folder() / "panda", "panda", columns=PANDA, links=links, progress=False)


def identification_table() -> str:
    """Return what the identified Panda explains on the end of the record, and its friction, one column per joint."""
    plain, full = identified(False), identified(True)
    rows = [
        ["explained by the file", *(f"{value:.3f}" for value in plain.explained_by_file)],
        ["with friction, rotor, load and delay", *(f"{value:.3f}" for value in plain.explained)],
        ["with links too", *(f"{value:.3f}" for value in full.explained)],
        ["dry friction [N m]", *map(_with_error, full.coulomb.value, full.coulomb.high)],
        ["rotor inertia [kg m²]", *map(_with_error, full.armature.value, full.armature.high)],
    ]
    return table(["joint", *(f"{i + 1}" for i in range(len(plain.joint_names)))], rows)


def _with_error(value: float, high: float) -> str:
    return f"{value:.2f} ± {high - value:.2f}"


def _payload(model: tarc.IdentifiedModel) -> Interval:
    assert model.payload is not None
    return model.payload


def without_file() -> str:
    """Return why the record does not show the inertia without a file."""
    try:
        tarc.inertia_from_log(data_folder() / "panda", columns=PANDA)
    except NotIdentifiable as error:
        return text_block(textwrap.fill(str(error), 92))
    raise RuntimeError("the record shows the inertia; correct the page")


def spread_of_cutoffs() -> dict[str, Value]:
    """Return the least and largest mean of what time-delay estimation leaves, for torques below 10 to 40 Hz."""
    left = panda().delay_estimation
    assert left is not None
    checks = [check_delay_estimation(panda().record, left.inertia, left.window, cutoff) for cutoff in CUTOFFS]
    shares = {
        "synchronised": [100 * float(np.mean(check.synchronised)) for check in checks if check is not None],
        "literal": [100 * float(np.mean(check.literal)) for check in checks if check is not None],
    }
    return {f"{name}_{kind.__name__}": kind(values) for name, values in shares.items() for kind in (min, max)}


def values() -> dict[str, Value]:
    """Return the tables and numbers of the page."""
    left, check = panda().delay_estimation, panda().windows[0]
    assert left is not None
    velocities = [kuka(run).velocity for run in KUKA_RUNS]
    links = [kuka_links(run).velocity for run in KUKA_RUNS]
    return {
        "timing": timing_table(),
        "delays": delay_table(),
        "joints": joint_table(),
        "identified": identification_table(),
        "load": float(_payload(identified(False)).value),
        "load_error": float(_payload(identified(False)).high - _payload(identified(False)).value),
        "torque_delay": -1e3 * float(identified(True).actuation_delay.value),
        "without_file": without_file(),
        "synchronised": 100 * float(np.mean(left.synchronised)),
        "literal": 100 * float(np.mean(left.literal)),
        "synchronised_raw": 100 * float(np.mean(left.synchronised_raw)),
        "literal_raw": 100 * float(np.mean(left.literal_raw)),
        **spread_of_cutoffs(),
        "stamped": float(np.sqrt(np.mean(check.error_of_stamps**2))),
        "even_rows": float(np.sqrt(np.mean(check.error_of_rows**2))),
        "repaired": float(np.sqrt(np.mean(check.error**2))),
        "noise": float(np.sqrt(np.mean(check.noise**2))),
        "motor_delay": float(np.mean([1e3 * v.delay for v in velocities if v is not None])),
        "link_delay": float(np.mean([1e3 * v.delay for v in links if v is not None])),
        "decorrelation": 1e6 * (1 - float(np.min([v.correlation for v in velocities if v is not None]))),
        "panda_delay": float(np.mean(1e3 * getattr(panda().velocity, "delay", np.nan))),
    }


def main() -> None:
    """Print the tables, or say that the records are not there."""
    try:
        found = values()
    except DataMissingError as missing:
        print(f"skipped: {missing}")
        return
    for name, value in found.items():
        print(f"\n{name}\n{value}")


if __name__ == "__main__":
    main()
