"""The inertia M̂ from records of positions and torques alone, without a model of the robot."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, NotIdentifiable
from tarc.core.types import Array
from tarc.core.validation import Table
from tarc.design.inertia_fit import MIN_ROWS, InertiaFit, nearest_positive_definite
from tarc.simulation.run import Run

WINDOWS = (6, 9, 13, 20, 30, 45, 65, 100, 150, 220)
"""Windows that are tried where none is given [periods]."""
MIN_WINDOWS_IN_RECORD = 30
"""Least duration of the record over a window that is tried."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedInertia:
    """An inertia from a record, and its uncertainty.

    Attributes
    ----------
    inertia
        M̂ [kg m² or kg], symmetric positive definite, shape (n, n): the mean of M(q) along the record, weighted by the
        square of the acceleration.
    error
        Standard error of each entry, shape (n, n), from the scatter between parts of the record. It does not contain
        errors that are the same in all parts, such as friction that is neither viscous nor Coulomb.
    explained
        Share of M q̈ in the torque that friction and gravity do not explain, shape (n,). The remainder is noise and
        the change of M(q) along the record.
    torque_share
        RMS of M q̈ over that of the torque about its mean, shape (n,).
    condition
        Condition number of the correlation of the joints' accelerations; 1 where they are independent.
    window
        ς of the filter [s].
    samples
        Number of instants that were used, up to four per window.
    """

    inertia: Array
    error: Array
    explained: Array
    torque_share: Array
    condition: float
    window: float
    samples: int

    def diagonal(self) -> "IdentifiedInertia":
        """Return the same with the diagonals of the inertia and its error alone."""
        return replace(self, inertia=np.diag(np.diag(self.inertia)), error=np.diag(np.diag(self.error)))


def inertia_from_data(
    position: Table,
    torque: Table,
    period: float,
    *,
    window: float | None = None,
    degree: int = 2,
    diagonal: bool = True,
) -> IdentifiedInertia:
    """Estimate M̂ by least squares from positions and applied torques.

    With the weights w of the acceleration estimate and the synchronous weights c of the torque,

        Σ_j c_j τ(k−1−j) = M Σ_j w_j q(k−j) + Σ_j c_j N(k−1−j)

    holds exactly for constant M under zero-order hold. In the equation of joint i, N is a combination of a constant,
    all positions (gravity), and the velocity of joint i and its sign (friction). They are filtered with c as well.

    Parameters
    ----------
    position
        q [rad or m], shape (k, n), one row per period; windows with a NaN are left out.
    torque
        τ [N m or N], shape (k, n), applied from that instant until the next one.
    period
        T [s].
    window
        ς [s], a multiple of the period; None for the one with which M q̈ explains most of the torque. A short one
        passes the noise of the positions, which makes M̂ too small; a long one removes the motion.
    degree
        Λ of the estimator, 2 or more.
    diagonal
        Keep the diagonal only. The whole of M is fitted in any case.

    Returns
    -------
    IdentifiedInertia
        M̂ near the postures of the record. For a robot that moves far, identify it at several postures: the mean is
        M̂, and the spread between them is what the loop must tolerate.

    Raises
    ------
    InvalidParameter
        For shapes that do not match, joints that do not move, and positions that wrap around.
    NotIdentifiable
        For a record that is too short, joints that only move together, and torque that M q̈ does not explain. Also for
        an M̂ that is not positive or too uncertain.

    References
    ----------
    For least squares on rigid-body dynamics: W. Khalil and E. Dombre, Modeling, Identification and Control of Robots,
    2002, chapter 12. The exact pair of filters is that of `tarc.estimators.base.synchronous_weights`.
    """
    T = check.number("period", period, 0, strict=True)
    q, tau = _record(position, torque)
    degree = check.integer("degree", degree, 2, 6)
    if window is None:
        windows = [N for N in WINDOWS if degree < N and len(q) >= MIN_WINDOWS_IN_RECORD * N]
    else:
        windows = [check.whole_periods("window", window, T)]
    tried = [InertiaFit.from_record(q, tau, T, N, degree) for N in windows if len(q) > N]
    fits = [fit for fit in tried if fit is not None]
    if not fits:
        complete = int(np.sum(np.isfinite(q + tau).all(axis=1)))
        raise NotIdentifiable(
            f"position: got {len(q)} samples, {complete} of them complete, and too few windows without a gap; needs "
            f"{MIN_ROWS} of them: record for longer, lose fewer samples or take a shorter window"
        )
    best = max(fits, key=lambda fit: float(np.mean(fit.explained)))
    best.check_identifiable()
    identified = IdentifiedInertia(
        inertia=nearest_positive_definite((best.inertia + best.inertia.T) / 2),
        error=np.sqrt((best.error**2 + best.error.T**2) / 4 * (1 + np.eye(len(best.error)))),
        explained=best.explained,
        torque_share=best.torque_share,
        condition=best.condition,
        window=best.window,
        samples=best.n_rows,
    )
    return identified.diagonal() if diagonal else identified


def inertia_from_file(
    path: str | Path,
    period: float | None = None,
    *,
    window: float | None = None,
    degree: int = 2,
    diagonal: bool = True,
) -> IdentifiedInertia:
    """Estimate M̂ from the file of a run, by `inertia_from_data`.

    Parameters
    ----------
    path
        A CSV with columns q1, …, qn, tau1, …, taun, where an empty field is a lost sample. Or a netCDF that
        `tarc.Run.save` wrote, of which the measured positions and the torques are used.
    period
        T [s]; None for that of the netCDF, or the step of a column ``t`` or ``time`` [s].
    window, degree, diagonal
        As in `inertia_from_data`.

    Raises
    ------
    InvalidParameter
        For a file that is missing or does not read, missing columns, and a period that is unknown or not even.
    NotIdentifiable
        As in `inertia_from_data`.
    """
    file = Path(path)
    if not file.is_file():
        raise InvalidParameter(f"path: no file {str(path)!r}; looked for {file.resolve()}")
    if file.suffix == ".nc":
        data = Run.load(file).data
        q, tau = data["measured_position"].values, data["torque"].values
        period = float(data.attrs["period"]) if period is None else period
    else:
        q, tau, file_period = _read_table(file, period is None)
        period = file_period if period is None else period
    return inertia_from_data(q, tau, period, window=window, degree=degree, diagonal=diagonal)


def _read_table(file: Path, needs_period: bool) -> tuple[Array, Array, float]:
    """Return positions, torques and the period of a CSV; NaN for a period that is not needed."""
    try:
        table = np.genfromtxt(file, delimiter=",", names=True, ndmin=1)
    except ValueError as error:
        raise InvalidParameter(f"path: {file} does not read as a table ({' '.join(str(error).split())[:80]})") from None
    names = table.dtype.names or ()
    n = max(1, sum(name.startswith("tau") for name in names))
    positions, torques = [f"q{i + 1}" for i in range(n)], [f"tau{i + 1}" for i in range(n)]
    missing = [name for pair in zip(positions, torques, strict=True) for name in pair if name not in names]
    if missing:
        raise InvalidParameter(
            f"path: {file} has columns {', '.join(names) or '(none)'}; it lacks {', '.join(missing)}"
        )
    q, tau = (np.column_stack([table[name] for name in columns]) for columns in (positions, torques))
    return q, tau, _table_period(table, file) if needs_period else np.nan


def _table_period(table: Array, file: Path) -> float:
    """Return the step of the column of times."""
    times = [table[name] for name in ("t", "time") if name in (table.dtype.names or ())]
    if not times:
        raise InvalidParameter(f"period: {file} has no column t or time; give the period [s]")
    steps = np.diff(times[0])
    period = float(np.median(steps))
    if not np.all(np.abs(steps - period) < 0.1 * period):
        raise InvalidParameter(
            f"path: the times in {file} are not even; their steps are {steps.min():g} to {steps.max():g} s"
        )
    return period


def _record(position: Table, torque: Table) -> tuple[Array, Array]:
    """Return positions and torques, (k, n) both, of joints that all move and do not wrap around."""
    q, tau = check.float_array("position", position), check.float_array("torque", torque)
    if q.ndim != 2 or q.shape != tau.shape or not q.size:
        raise InvalidParameter(
            f"position, torque: got shapes {q.shape} and {tau.shape}; needs (k, n) both, a column per joint"
        )
    q = np.where(np.isfinite(q), q, np.nan)
    span = np.nanmax(q, axis=0, initial=-np.inf) - np.nanmin(q, axis=0, initial=np.inf)
    if not np.all(span > 0):
        raise InvalidParameter(
            f"position: joint {np.argmin(span) + 1} never moves; move each joint, as excitation_reference(…) does"
        )
    jumps = np.nanmax(np.abs(np.diff(q, axis=0)), axis=0, initial=0)
    if np.any(jumps > np.pi):
        i = int(np.argmax(jumps))
        raise InvalidParameter(
            f"position: joint {i + 1} jumps by {jumps[i]:.3g} between samples; unwrap it, numpy.unwrap"
        )
    return q, tau
