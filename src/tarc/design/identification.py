"""The inertia M̂ from records of positions and torques alone, where there is no model of the robot."""

import warnings
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import DesignWarning, InvalidParameter, NotIdentifiable
from tarc.core.types import Array
from tarc.core.validation import Numbers, Table
from tarc.estimators.algebraic import Algebraic
from tarc.estimators.base import synchronous_weights
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.signals.references import Multisine, Reference
from tarc.signals.sensors import Encoder
from tarc.simulation.run import Run
from tarc.simulation.simulator import simulate

WINDOWS = (6, 9, 13, 20, 30, 45, 65, 100, 150, 220)
"""Windows [periods] that are tried where none is given."""
BLOCKS = 20
"""Parts of a record that count as independent, for the standard error."""
MAX_CONDITION = 100.0
"""Condition number of the accelerations' correlation beyond which joints are not told apart."""
MIN_EXPLAINED = 0.5
"""Least share that M q̈ must have of the torque that friction and gravity leave."""
MIN_TORQUE_SHARE = 0.15
"""Least RMS that M q̈ must have, by that of the torque; a joint that friction holds has less, whatever it explains."""
MIN_ROWS = 5 * BLOCKS
"""Fewest instants."""
MAX_RELATIVE_ERROR = 0.25
"""Largest standard error, by the inertia itself."""
MAX_RUNS = 12
"""Most tries of `identify`."""
INERTIA_RATIO = 0.5
"""Inertia ratio of its last run, well within the stable range of its law, 0.013 to 2.97 at 1 ms."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """An inertia from a record, and how far to trust it.

    Attributes
    ----------
    inertia
        M̂ [kg m² or kg], symmetric positive definite, shape (n, n): the mean of M(q) along the record, weighted by the
        square of the acceleration.
    error
        Standard error of each entry, shape (n, n), from the scatter between parts of the record. It is blind to what
        is wrong all along, such as friction that is neither viscous nor Coulomb.
    explained
        Share of M q̈ in the torque that friction and gravity leave, one a joint; the rest is noise and what M(q)
        changes along the way.
    share
        RMS of M q̈ by that of the torque about its mean, one a joint.
    condition
        Condition number of the correlation of the joints' accelerations; 1 where they are independent.
    window
        ς of the filter [s].
    samples
        How many instants were used, up to four a window.
    """

    inertia: Array
    error: Array
    explained: Array
    share: Array
    condition: float
    window: float
    samples: int

    def diagonal(self) -> "Identified":
        """The same with the diagonals of the inertia and its error alone."""
        return replace(self, inertia=np.diag(np.diag(self.inertia)), error=np.diag(np.diag(self.error)))


def inertia_from_data(
    position: Table,
    torque: Table,
    period: float,
    *,
    window: float | None = None,
    degree: int = 2,
    diagonal: bool = True,
) -> Identified:
    """M̂ by least squares from positions and the torques applied.

    Filtered with the weights w of the acceleration estimate and the synchronous weights c of the torque,

        Σ_j c_j τ(k−1−j) = M Σ_j w_j q(k−j) + Σ_j c_j N(k−1−j)

    holds exactly for constant M under zero-order hold. For N stand, in the equation of joint i, a constant, all
    positions (gravity), the velocity and the sign of the velocity of joint i (friction), filtered with c as well.

    Parameters
    ----------
    position
        q [rad or m], shape (k, n), a row a period; where one is NaN, all windows that hold it are left out.
    torque
        τ [N m or N], shape (k, n), applied from that instant until the next one.
    period
        T [s].
    window
        ς [s], a multiple of the period; None for the one of several with which M q̈ explains most of the torque. Short
        ones let the noise of the positions through, which makes M̂ too small; long ones none of the motion.
    degree
        Λ of the estimator, 2 or more.
    diagonal
        Keep the diagonal only. All of M is fitted anyway.

    Returns
    -------
    Identified
        With the M̂ about the place of the record. For a robot that moves far, take one at each of several postures:
        their mean is M̂, and how they differ is what M̂ must bear.

    Raises
    ------
    TarcError
        For shapes that do not match, joints that do not move or only together, a record that is too short, torque that
        M q̈ does not explain, and an M̂ that is not positive or too uncertain.

    References
    ----------
    For least squares on rigid-body dynamics: W. Khalil and E. Dombre, Modeling, Identification and Control of Robots,
    2002, chapter 12. The exact pair of filters is that of `tarc.estimators.base.synchronous_weights`.
    """
    T = check.number("period", period, 0, strict=True)
    q, tau = _record(position, torque)
    degree = check.integer("degree", degree, 2, 6)
    if window is None:
        periods = [N for N in WINDOWS if degree < N and len(q) >= 30 * N]
    else:
        periods = [check.whole_periods("window", window, T)]
    fits = [fit for fit in (_Fit(q, tau, T, N, degree) for N in periods if len(q) > N) if fit.rows >= MIN_ROWS]
    if not fits:
        whole = int(np.sum(np.isfinite(q + tau).all(axis=1)))
        raise NotIdentifiable(
            f"position: got {len(q)} samples, {whole} of them whole, and too few windows without a gap; needs "
            f"{MIN_ROWS} of them: record for longer, lose fewer samples or take a shorter window"
        )
    best = max(fits, key=lambda fit: float(np.mean(fit.explained)))
    best.check_identifiable()
    error = np.sqrt((best.error**2 + best.error.T**2) / 4 * (1 + np.eye(len(best.M))))
    found = Identified(
        inertia=nearest_positive_definite((best.M + best.M.T) / 2),
        error=error,
        explained=best.explained,
        share=best.share,
        condition=best.condition,
        window=best.window,
        samples=best.rows,
    )
    return found.diagonal() if diagonal else found


def inertia_from_file(path: str | Path, period: float | None = None, **options: Any) -> Identified:
    """M̂ from a file of a run, by `inertia_from_data`.

    Parameters
    ----------
    path
        A CSV with a header that has q1, …, qn, tau1, …, taun (an empty field is a lost sample), or a netCDF that
        `tarc.Run.save` wrote, of which the measured positions and the torques are taken.
    period
        T [s]; None for what the netCDF says, or the step of a column ``t`` or ``time`` [s].
    options
        As `inertia_from_data` takes them.

    Raises
    ------
    TarcError
        For a file that is missing or does not read, missing columns, a period that is unknown or not even, and as
        `inertia_from_data`.
    """
    file = Path(path)
    if not file.is_file():
        raise InvalidParameter(f"path: no file {str(path)!r}; looked for {file.resolve()}")
    if file.suffix == ".nc":
        data = Run.load(file).data
        period = float(data.attrs["period"]) if period is None else period
        return inertia_from_data(data["measured_position"].values, data["torque"].values, period, **options)
    try:
        table = np.genfromtxt(file, delimiter=",", names=True, ndmin=1)
    except ValueError as error:
        raise InvalidParameter(f"path: {file} does not read as a table ({' '.join(str(error).split())[:80]})") from None
    names = table.dtype.names or ()
    columns = [(f"q{i}", f"tau{i}") for i in range(1, 1 + max(1, sum(name.startswith("tau") for name in names)))]
    missing = [name for pair in columns for name in pair if name not in names]
    if missing:
        raise InvalidParameter(
            f"path: {file} has columns {', '.join(names) or '(none)'}; it lacks {', '.join(missing)}"
        )
    if period is None:
        times = [table[name] for name in ("t", "time") if name in names]
        if not times:
            raise InvalidParameter(f"period: {file} has no column t or time; give the period [s]")
        steps = np.diff(times[0])
        period = float(np.median(steps))
        if not np.all(np.abs(steps - period) < 0.1 * period):
            raise InvalidParameter(
                f"path: the times in {file} are not even; their steps are {steps.min():g} to {steps.max():g} s"
            )
    q, tau = (np.column_stack([table[pair[which]] for pair in columns]) for which in (0, 1))
    return inertia_from_data(q, tau, period, **options)


def excitation_reference(
    home: Numbers,
    *,
    duration: float = 20.0,
    amplitude: Numbers = 0.2,
    speed: Numbers = 1.0,
    low: Numbers = -np.inf,
    high: Numbers = np.inf,
    band: tuple[float, float] = (2.0, 30.0),
    tones: int = 4,
) -> Multisine:
    """A motion that shows the inertia: sines about a posture, of other frequencies for each joint.

        qᵈ_i = home_i + a_i Σ_m (−1)^m sin(ω_im t)/ω_im

    It starts at home, at rest and without acceleration; a_i is the largest that the bounds allow. All frequencies are
    odd multiples of 2π/duration, so that products of two of them, as in Coriolis torque and in what M(q) changes, are
    even ones and do not pass for an acceleration.

    Parameters
    ----------
    home
        Posture in the middle [rad or m], shape (n,).
    duration
        After which it repeats [s].
    amplitude, speed
        Bounds on the way from home [rad or m] and on the velocity [rad/s or m/s], one number or one a joint.
    low, high
        Ends of the joints' ranges [rad or m], which are not passed; infinite for none.
    band
        Lowest and highest frequency [rad/s].
    tones
        Sines a joint, an even number.

    Raises
    ------
    TarcError
        For a home at the end of a range, an odd number of tones, and a band with too few multiples for all joints.
    """
    middle = np.atleast_1d(check.array("home", home))
    n, base = len(middle), 2 * np.pi / check.number("duration", duration, 0, strict=True)
    first, last = check.number("band", band[0], 0, strict=True) / base, check.number("band", band[1], band[0]) / base
    count = n * check.integer("tones", tones, 2)
    if tones % 2:
        raise InvalidParameter(f"tones: got {tones}; needs an even number, so that the motion starts at rest")
    if count > (last - first) / 2:
        raise InvalidParameter(
            f"band: {band} has {(last - first) / 2:.0f} odd multiples of 2π/{duration:g} s, for {count} sines; needs a "
            "longer duration, a wider band or fewer tones"
        )
    ends = [check.float_array(name, one) for name, one in (("low", low), ("high", high))]
    if any(end.shape not in ((), (n,)) for end in ends):
        raise InvalidParameter(
            f"low, high: got shapes {[end.shape for end in ends]}; needs one number or {n}, one per joint"
        )
    room = check.vector("amplitude", amplitude, n, 0, strict=True)
    room = np.minimum(room, np.minimum(middle - ends[0], ends[1] - middle))
    if not np.all(room > 0):
        i = int(np.argmin(room))
        raise InvalidParameter(f"home: joint {i + 1} at {middle[i]:g} is not inside its range; choose another posture")
    multiples = 2 * (np.geomspace(first, last, count) // 2) + 1
    for k in range(1, count):
        multiples[k] = max(multiples[k], multiples[k - 1] + 2)
    frequency, table = base * multiples, np.zeros((n, count))
    for m in range(tones):  # there and back, so that no joint has the lower one each time
        column = m * n + (np.arange(n) if m % 2 else np.arange(n)[::-1])
        table[np.arange(n), column] = (-1.0) ** m / frequency[column]
    shape = Multisine(amplitude=table, frequency=frequency, phase=0 * table)
    q, v, _ = shape.sample(np.linspace(0, duration, 40 * int(multiples[-1])))
    bound = check.vector("speed", speed, n, 0, strict=True)
    scale = 0.99 * np.minimum(room / np.abs(q).max(axis=1), bound / np.abs(v).max(axis=1))
    return Multisine(amplitude=scale[:, None] * table, frequency=frequency, phase=0 * table, offset=middle)


def identify(
    plant: Plant,
    *,
    period: float = 1e-3,
    sensor: Encoder | None = None,
    reference: Reference | None = None,
    duration: float | None = None,
    torque: Any = "rest",
    guess: float = 1e-3,
    diagonal: bool = True,
    seed: int = 0,
) -> Identified:
    """M̂ of a robot that is simulated, from its encoders and torques alone: what one would do with a real one.

    The motion needs a law and the law an M̂. Synchronised time-delayed control with a low natural frequency errs
    mildly where
    M̂ is too small: the joint drifts off slowly, and the run is stopped. So all joints start from a tiny M̂, and those
    that do not follow get four times theirs, until the record shows M. A last run with the ratio `RATIO` moves as the
    reference asks, and is the one that counts.

    Parameters
    ----------
    plant
        The robot, whose model no law and no estimate here uses.
    period
        T [s].
    sensor
        Its encoders; None for perfect ones.
    reference
        The motion; None for `excitation` about home, within the ranges that
        `tarc.analysis.Workspace.from_joint_limits` knows.
    duration
        [s]; None for 20, or more for more than eight joints.
    torque
        Applied before the start [N m or N], as `tarc.simulate` takes it: ``"rest"`` for what brakes hold, 0 for an arm
        that is let go.
    guess
        M̂ to start from [kg m² or kg]; should be too small.
    diagonal
        As `inertia_from_data` takes it.
    seed
        Of the encoders' noise.

    Raises
    ------
    TarcError
        When no M̂ makes the robot follow, when it follows and M does not show, and for a reference at rest.
    """
    if not isinstance(plant, Plant):
        raise InvalidParameter(f"plant: got {plant!r}; needs one of tarc.plants")
    period = check.number("period", period, 0, strict=True)
    length = max(20.0, 2.5 * plant.n_joints) if duration is None else duration
    motion = _motion(plant, length) if reference is None else reference
    path = motion.sample(np.arange(0, length, period))[0]
    reach, size = float(np.max(np.ptp(path, axis=1))), np.std(path, axis=1)
    if not np.all(size > 0):
        raise InvalidParameter(
            "reference: it leaves a joint at rest; give all of them a motion, as excitation_reference(…) does"
        )
    inertia = np.full(plant.n_joints, check.number("guess", guess, 0, strict=True))
    estimator = Algebraic(window=10 * period)

    def move(inertia: Array) -> Run:
        law = TDC(inertia=inertia, natural_frequency=5.0, period=period, estimator=estimator, synchronised=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)
            return simulate(
                plant, law, motion, length, sensor=sensor, initial_torque=torque, divergence_threshold=reach, seed=seed
            )

    def shown(run: Run) -> Identified:
        return inertia_from_data(
            run.data["measured_position"].values, run.data["torque"].values, period, diagonal=False
        )

    for _ in range(MAX_RUNS):
        run = move(inertia)
        missed = np.abs(run.data["measured_position"].values - run.data["reference"].values)
        behind = np.sqrt(np.nanmean(missed**2, axis=0)) > 0.5 * size
        moved = np.nanstd(run.data["measured_position"].values, axis=0) > 0.5 * size
        if run.status.completed and moved.all():
            try:
                found = shown(run)
                break
            except NotIdentifiable:
                if not behind.any():
                    raise
        elif not run.status.completed:
            behind[np.argmax(np.nanmax(missed, axis=0))] = True
        inertia = np.where(behind, 4 * inertia, inertia)
    else:
        raise NotIdentifiable(
            f"identify: with an M̂ from {guess:g} up to {inertia.max() / 4:g} the robot does not follow the motion; "
            "start from another guess, or give a reference that is slower, or larger where friction holds the joint"
        )
    run = move(INERTIA_RATIO * found.inertia)
    if run.status.completed:
        with suppress(NotIdentifiable):
            found = shown(run)
    return found.diagonal() if diagonal else found


def _motion(plant: Plant, duration: float) -> Multisine:
    """The excitation about home, within the ranges where they are known."""
    low, high = plant.position_limits.T
    return excitation_reference(plant.home, duration=duration, low=low, high=high)


def _record(position: Table, torque: Table) -> tuple[Array, Array]:
    """Positions and torques, (k, n) both, of joints that all move and none of which wraps around."""
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


class _Fit:
    """Least squares with one window: M and its standard errors (n, n), shares explained, condition, rows used."""

    def __init__(self, q: Array, tau: Array, T: float, periods: int, degree: int) -> None:
        self.window, n = periods * T, q.shape[1]
        w = Algebraic(window=self.window, degree=degree).with_period(T).weights(2)
        c = synchronous_weights(w, T)
        velocity, half = np.diff(q, axis=0) / T, max(periods // 2, 2)
        smooth = _filter(np.pad(velocity, ((half, half), (0, 0)), mode="edge"), np.ones(2 * half + 1))
        inputs = tau[:-1], (q[1:] + q[:-1]) / 2, velocity, np.sign(smooth)
        parts = _filter(q, w), *(_filter(one, c) for one in inputs)
        every = max(1, periods // 4)  # instants closer together tell hardly more
        table = np.hstack(parts)[::every]
        sound = np.flatnonzero(np.isfinite(table.sum(axis=1)))
        acceleration, torque, place, rate, sign = np.split(table[sound], 5, axis=1)
        self.rows = len(acceleration)
        if self.rows < MIN_ROWS:
            return
        block = BLOCKS * sound // len(table)
        self.M, self.error, self.explained, self.condition = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), 1.0
        for i in range(n):
            rest = np.column_stack([np.ones(self.rows), place, rate[:, i], sign[:, i]])
            X, y = residual(rest, acceleration), residual(rest, torque[:, i])
            size = np.maximum(np.sqrt(np.sum(X**2, axis=0)), 1e-300)
            X = X / size
            values, vectors = np.linalg.eigh(X.T @ X)
            self.condition = max(self.condition, float(values[-1] / max(values[0], 1e-300)))
            inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T
            m = inverse @ (X.T @ y)
            left = y - X @ m
            scores = np.array([X[block == b].T @ left[block == b] for b in range(BLOCKS)])
            self.M[i] = m / size
            self.error[i] = np.sqrt(np.sum((scores @ inverse) ** 2, axis=0) * BLOCKS / (BLOCKS - 1)) / size
            self.explained[i] = 1 - left @ left / max(y @ y, 1e-300)
        self.share = np.std(acceleration @ self.M.T, axis=0) / np.maximum(np.std(torque, axis=0), 1e-300)

    def check_identifiable(self) -> None:
        """Raise `NotIdentifiable` if the motion does not determine M."""
        if self.condition > MAX_CONDITION:
            raise NotIdentifiable(
                f"position: the joints accelerate together, with condition {self.condition:.3g} of at most "
                f"{MAX_CONDITION:g}; "
                "give each several frequencies of its own, as excitation_reference(…) does"
            )
        found, error = np.diag(self.M), np.diag(self.error)
        weak = (self.explained < MIN_EXPLAINED) | (self.share < MIN_TORQUE_SHARE)
        bad = np.flatnonzero(weak | (found <= 0) | (error > MAX_RELATIVE_ERROR * found))
        if bad.size:
            i = int(bad[0])
            raise NotIdentifiable(
                f"torque: joint {i + 1} does not show its inertia, found as {found[i]:.3g} ± {error[i]:.2g}. M q̈ is "
                f"{self.share[i]:.0%} of the torque and explains {self.explained[i]:.0%} of what friction and gravity "
                f"leave; needs {MIN_TORQUE_SHARE:.0%}, {MIN_EXPLAINED:.0%} and an error within "
                f"{MAX_RELATIVE_ERROR:.0%}: move it faster, farther and for longer"
            )


def _filter(values: Array, weights: Array) -> Array:
    """Weighted sums of each column over the newest samples, newest first, wherever the window is full."""
    return np.column_stack([np.convolve(column, weights, "valid") for column in values.T])


def residual(rest: Array, values: Array) -> Array:
    """What the columns of rest do not account for; twice, for the rounding of the first time.

    By normal equations: for tall matrices a threaded LAPACK takes far longer where the cores are shared.
    """
    rest = rest / np.maximum(np.sqrt(np.sum(rest**2, axis=0)), 1e-300)
    inverse = np.linalg.pinv(rest.T @ rest, hermitian=True)
    for _ in range(2):
        values = values - rest @ (inverse @ (rest.T @ values))
    return values


def nearest_positive_definite(M: Array) -> Array:
    """The matrix with its diagonal kept and the eigenvalues of its correlation raised to 0.01."""
    root = np.sqrt(np.diag(M))
    values, vectors = np.linalg.eigh(M / np.outer(root, root))
    near = (vectors * np.maximum(values, 0.01)) @ vectors.T
    size = root / np.sqrt(np.diag(near))
    return (near + near.T) / 2 * np.outer(size, size)
