"""The loop: one read, one step of the law and one write per period, from the brakes to the brakes."""

from dataclasses import dataclass

import numpy as np

from tarc.control.controller import Controller
from tarc.control.watch import Watcher
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.runtime.clock import Clock
from tarc.runtime.gain_changes import GainChanges
from tarc.runtime.limits import SafetyLimits
from tarc.runtime.log_format import LogLayout, Phase
from tarc.runtime.motion import Motion, ramp, rest, stop
from tarc.runtime.push import Push, PushResponse, PushTest
from tarc.runtime.ring import Ring
from tarc.runtime.robot import Robot
from tarc.runtime.watchdog import Watchdog
from tarc.signals.readings import ReadingCheck

OVERRUN_POLICIES = ("bridge", "skip", "stop", "shift")
ROUNDING = 1e-9
"""Share of a torque limit that counts as rounding."""
CLOCK_GAIN = 0.01
"""Share of the distance from the robot's clock that a period makes up for."""
ALIGNMENT_PERIODS = 5
"""Periods in which the instant of the robot's samples is looked for."""
MARGIN = 1.5
"""Periods that are timed, as a multiple of those that are planned."""
COMPLETED = "completed"


@dataclass(frozen=True, kw_only=True, eq=False)
class StartUp(Component):
    """How a run starts and ends.

    Parameters
    ----------
    holding_torque
        Torque that the brakes carry [N m or N], one number or one per joint. None for what the robot reports, else
        zero.
    hold_time
        Time at rest with the law before the ramp [s].
    ramp_time
        Duration of the ramp to the start of the reference [s]; None for one by ``ramp_speed``.
    ramp_speed
        Peak speed of a ramp between two points of rest [rad/s or m/s].
    push
        A push of each joint before the law starts; None for none.
    brake_time
        Time that the brakes take to open and to close [s]; the torque stays meanwhile.
    stop_time
        Time of a stop at the end or by Ctrl-C, in which the reference comes to rest [s].
    patience
        Time to wait for the first valid position [s].
    """

    holding_torque: Numbers | None = None
    hold_time: float = 0.2
    ramp_time: float | None = None
    ramp_speed: float = 0.25
    push: Push | None = None
    brake_time: float = 0.1
    stop_time: float = 0.3
    patience: float = 2.0

    def __post_init__(self) -> None:
        for name in ("hold_time", "brake_time", "stop_time", "patience"):
            check.number(name, getattr(self, name), 0)
        if self.ramp_time is not None:
            check.number("ramp_time", self.ramp_time, 0)
        check.number("ramp_speed", self.ramp_speed, 0, strict=True)


@dataclass(frozen=True)
class LoopParts:
    """What a loop consists of.

    Attributes
    ----------
    controller, robot, limits, start_up
        Controller and robot, limits and start-up.
    layout, ring
        Where each period is recorded.
    clock, watchdog, watchdog_time
        Clock, thread that watches the loop, and the longest time without a sample [s].
    overrun
        One of `OVERRUN_POLICIES`.
    watcher
        Watch of the certificate's assumptions; None for none.
    changes
        Gains that change meanwhile; None for none.
    """

    controller: Controller
    robot: Robot
    limits: SafetyLimits
    start_up: StartUp
    layout: LogLayout
    ring: Ring
    clock: Clock
    watchdog: Watchdog
    watchdog_time: float
    overrun: str
    watcher: Watcher | None
    changes: GainChanges | None


class LiveLoop:
    """A run on a robot.

    Attributes
    ----------
    ended
        Why the run ended; empty while it goes on.
    stop_request
        Reason for which the run is to stop; empty for none.
    overruns
        Periods that were missed.
    lateness, computation_time
        Of each period that was not missed [s].
    push
        What the pushes showed.
    tracking_start
        Time at which the reference began [s]; NaN before.
    flags_seen
        All bits of `tarc.WatchFlag` that were set.
    """

    def __init__(self, parts: LoopParts, reference: Motion):
        self._parts, self._reference = parts, reference
        self._controller, self._robot, self._clock = parts.controller, parts.robot, parts.clock
        law = parts.controller.law
        self._period, self._n = law.period, law.n_joints
        self._max_torque = parts.limits.largest_torque(law) * (1 + ROUNDING)
        self._max_error, self._max_speed = parts.limits.rows(self._n)
        self._readings = ReadingCheck(parts.limits.span, parts.limits.max_step)
        self._readings.check_joints(self._n)
        self._velocity = parts.controller.signals["velocity_estimate"]
        self._row = np.full(parts.layout.width, np.nan)
        self._views = parts.layout.views(self._row)
        self._signals = [(self._views[name], values) for name, values in parts.controller.signals.items()]
        self._nothing = np.full(self._n, np.nan)
        self._torque = np.zeros(self._n)
        self._target = np.zeros(self._n), np.zeros(self._n), np.zeros(self._n)
        self._start = self._origin = self._begin = self._last_sample = 0.0
        self._last_stamp = np.nan
        self._stamp_offset: float | None = None
        self._k = 0
        self._lateness = 0.0
        self._is_orderly = self._is_stopping = self._is_aborted = False
        self.rejected = 0
        self.ended, self.stop_request, self.overruns, self.flags_seen = "", "", 0, 0
        self.push: tuple[PushResponse, ...] = ()
        self.tracking_start = np.nan
        self._timed = 0
        self._times = np.zeros((2, 1))

    @property
    def n_periods(self) -> int:
        """Return the number of periods so far."""
        return self._k

    @property
    def lateness(self) -> Array:
        """Return how late each period began [s]."""
        return self._times[0, : self._timed]

    @property
    def computation_time(self) -> Array:
        """Return how long each period took until its torque was written [s]."""
        return self._times[1, : self._timed]

    @property
    def is_safe_stop(self) -> bool:
        """Return whether the run ended in a safe stop."""
        return bool(self.ended) and not self._is_orderly

    def interrupt(self, *_: object) -> None:
        """Stop by the reference, and at once where that was said before: the handler of Ctrl-C."""
        self._is_aborted = bool(self.stop_request) or self._is_stopping
        self.stop_request = "stopped on request"

    def run(self) -> None:
        """Run from the brakes to the brakes."""
        start_up = self._parts.start_up
        position = self._first_position()
        holding = self._holding_torque()
        self._controller.reset(position, holding)
        self._target = position, np.zeros(self._n), np.zeros(self._n)
        motions = self._motions(position)
        self._times = np.zeros((2, int(MARGIN * sum(len(motion) for _, motion in motions)) + self._periods(10.0)))
        test = None if start_up.push is None else PushTest(start_up.push, self._controller.law)
        self._align()
        self._open_brakes(holding)
        if start_up.push is not None and test is not None and not self.ended:
            self._push(start_up.push, test, holding)
            if not self.ended:
                self._controller.reset(self._last_valid, holding)
        for phase, motion in motions:
            if phase == Phase.TRACK:
                self.tracking_start = self._k * self._period
            self._follow(phase, motion)
        self._finish()

    def _first_position(self) -> Array:
        """Return the first position that is finite.

        Raises
        ------
        InvalidParameter
            Where none comes in time, and for another number of joints.
        """
        end = self._clock.now() + self._parts.start_up.patience
        while True:
            position = np.array(self._robot.read(), dtype=float)
            if position.shape != (self._n,):
                raise InvalidParameter(
                    f"robot: its positions have shape {position.shape}; the law has {self._n} joints", "robot"
                )
            if np.all(np.isfinite(position)):
                self._last_valid = position
                self._last_sample = self._clock.now()
                return position
            if self._clock.now() > end:
                raise InvalidParameter(
                    f"robot: no valid position within {self._parts.start_up.patience:g} s; the last one was "
                    f"{position.tolist()}; check its encoders and its connection",
                    "robot",
                )
            self._clock.sleep_until(self._clock.now() + self._period / 4)

    def _holding_torque(self) -> Array:
        """Return the torque that the brakes carry (n,), within the limits."""
        given, reported = self._parts.start_up.holding_torque, self._robot.applied_torque
        torque = np.zeros(self._n)
        if given is not None:
            torque = check.vector("holding_torque", given, self._n)
        elif reported is not None:
            torque = np.where(np.isfinite(reported), reported, 0.0)
        return np.clip(torque, -self._max_torque, self._max_torque)

    def _motions(self, position: Array) -> list[tuple[Phase, Motion]]:
        start_up = self._parts.start_up
        first = self._reference.position[0]
        self._reference = self._reference.shifted(self._readings.unwrap(position, first) - first)
        to_start = ramp(position, self._reference, self._period, time=start_up.ramp_time, speed=start_up.ramp_speed)
        hold = rest(position, self._periods(start_up.hold_time))
        return [(Phase.HOLD, hold), (Phase.RAMP, to_start), (Phase.TRACK, self._reference)]

    def _periods(self, time: float) -> int:
        return max(1, round(time / self._period))

    def _align(self) -> None:
        """Let the periods begin half a period after the robot's samples come."""
        arrival = self._clock.now()
        end = arrival + ALIGNMENT_PERIODS * self._period
        while self._clock.is_real and self._clock.now() < end:
            if np.any(np.isfinite(self._robot.read())):
                arrival = self._clock.now()
                break
            self._clock.sleep_until(self._clock.now() + self._period / 20)
        self._start = self._origin = arrival + self._period / 2
        self._last_sample = arrival

    def _open_brakes(self, holding: Array) -> None:
        """Take the torque over from the brakes."""
        for _ in range(self._periods(self._parts.start_up.brake_time)):
            self._raw_period(Phase.HOLD, holding)
        self._robot.release_brakes()

    def _push(self, push: Push, test: PushTest, holding: Array) -> None:
        """Push one joint at a time, and stop where one does not answer as it should."""
        size = push.share * self._max_torque
        profile = push.profile(self._period)
        responses = []
        start = self._last_valid.copy()
        for joint in range(self._n):
            torques, positions = np.zeros((2, len(profile)))
            for k, sign in enumerate(profile):
                command = holding.copy()
                command[joint] += sign * size[joint]
                position = self._raw_period(Phase.PUSH, self._limited(command))
                positions[k], torques[k] = position[joint], self._torque[joint] - holding[joint]
                travel = float(np.max(np.abs(self._last_valid - start)))
                if travel > push.max_travel:
                    self._give_up(f"a push moved a joint by {travel:.3g}, and {push.max_travel:g} is allowed")
                if self.ended or self.stop_request:
                    return
            responses.append(test.response(joint, torques, positions))
            self.push = tuple(responses)
            if responses[-1].fault:
                self._give_up(f"push: joint {joint + 1} {responses[-1].fault}")
                return

    def _limited(self, command: Array) -> Array:
        """Return the nearest torque to a command that the limits allow after the last one."""
        command = np.clip(command, -self._max_torque, self._max_torque)
        interface = self._parts.limits.interface
        return command if interface is None else interface.apply(command, self._torque, self._period)

    def _follow(self, phase: Phase, motion: Motion) -> None:
        """Let the law follow a motion, until its end or until there is a reason to stop."""
        j = 0
        while j < len(motion) and not self.ended and (not self.stop_request or phase == Phase.STOP):
            j = self._law_period(phase, motion, j)

    def _finish(self) -> None:
        """Come to rest and engage the brakes; after a fault at once, with the safe torque."""
        start_up = self._parts.start_up
        braking = self._periods(start_up.brake_time)
        if not self.ended:
            reason = self.stop_request or COMPLETED
            self.stop_request, self._is_stopping = "", True
            position, velocity, acceleration = self._target
            self._follow(Phase.STOP, stop(position, velocity, acceleration, self._period, start_up.stop_time))
            if not self.ended:
                self._is_orderly, self.ended = True, reason
                self._robot.engage_brakes()
        place = rest(self._target[0], braking)
        phase = Phase.STOP if self._is_orderly else Phase.SAFE_STOP
        j = 0
        while j < braking:
            j = self._law_period(phase, place, j)

    def _law_period(self, phase: Phase, motion: Motion, j: int) -> int:
        """Run one period with the law; return the row of the next one."""
        missed = self._wait()
        held = None
        if missed and self._parts.overrun == "bridge":
            held = self._torque.copy()
            self._bridge(missed, motion, j, held)
        if self._parts.changes is not None:
            self._parts.changes.apply()
        j = min(j + missed, len(motion) - 1)
        self._target = motion.at(j)
        position = self._read()
        torque = self._controller.step(position, *self._target, applied_torque=held)
        if not self.ended:
            reason = self._fault(position, missed)
            if reason:
                self._give_up(reason)
                phase = Phase.SAFE_STOP
                torque = self._controller.step(position, *self._target)
        self._write(torque)
        self._record(phase, position, missed)
        return j + 1

    def _raw_period(self, phase: Phase, torque: Array) -> Array:
        """Run one period with a torque of its own (n,); return the position."""
        missed = self._wait()
        position = self._read()
        reason = self._late_sample(missed)
        if reason and not self.ended:
            self._give_up(reason)
            phase = Phase.SAFE_STOP
        self._write(torque)
        self._record(phase, position, missed)
        return position

    def _wait(self) -> int:
        """Sleep until the next deadline; return how many periods were missed, and are not made up for by a shift."""
        deadline = self._start + self._k * self._period
        self._clock.sleep_until(deadline)
        self._begin = self._clock.now()
        self._parts.watchdog.beat()
        missed = int((self._begin - deadline) / self._period)
        self._lateness = self._begin - deadline
        self.overruns += missed
        if self._parts.overrun == "shift":
            self._start += missed * self._period
            return 0
        self._k += missed
        return missed

    def _bridge(self, missed: int, motion: Motion, j: int, held: Array) -> None:
        """Step the law through missed periods, in which no sample came and the robot held its torque (n,)."""
        for i in range(min(missed, self._controller.law.max_missing + 1)):
            target = motion.at(min(j + i, len(motion) - 1))
            self._controller.step(self._nothing, *target, applied_torque=held)

    def _read(self) -> Array:
        """Return the position, unwrapped and without jumps, and follow the robot's clock."""
        raw = np.asarray(self._robot.read(), dtype=float)
        is_finite = np.isfinite(raw)
        if not np.any(is_finite):
            return self._nothing
        position = np.where(is_finite, raw, np.nan)
        if self._readings.is_needed:
            _, position = self._readings.step(self._last_valid, position)
            self.rejected += int(np.count_nonzero(is_finite & np.isnan(position)))
        self._last_sample = self._begin
        self._last_valid = np.where(np.isfinite(position), position, self._last_valid)
        stamp = self._robot.sample_time
        if np.isfinite(stamp):
            self._follow_clock(stamp - self._start - self._k * self._period)
        return position

    def _follow_clock(self, offset: float) -> None:
        """Move the deadlines by a small part of what the robot's clock moved against this one's, within a period."""
        if self._stamp_offset is None:
            self._stamp_offset = offset
        distance = (offset - self._stamp_offset + self._period / 2) % self._period - self._period / 2
        self._start += CLOCK_GAIN * distance

    def _fault(self, position: Array, missed: int) -> str:
        """Return why the run must stop at once; empty where nothing is wrong."""
        late = self._late_sample(missed)
        if late:
            return late
        if self._controller.fault:
            return self._controller.fault_reason
        error = np.abs(position - self._target[0])
        if np.any(error > self._max_error):
            i = int(np.nanargmax(error / self._max_error))
            return f"joint {i + 1} is {error[i]:.3g} from its reference, and {self._max_error[i]:g} is allowed"
        speed = np.abs(self._velocity)
        if np.any(speed > self._max_speed):
            i = int(np.nanargmax(speed / self._max_speed))
            return f"joint {i + 1} has a speed of {speed[i]:.3g}, and {self._max_speed[i]:g} is allowed"
        return ""

    def _late_sample(self, missed: int) -> str:
        silence = self._begin - self._last_sample
        if self._is_aborted:
            return "stopped twice on request"
        if self._parts.watchdog.has_fired:
            return "the loop stood still for longer than the watchdog's time"
        if missed and self._parts.overrun == "stop":
            return f"the loop missed {missed} periods"
        if silence > self._parts.watchdog_time - self._period:  # the next period would be too late
            return f"no sample came for {silence:.3g} s (watchdog)"
        return ""

    def _give_up(self, reason: str) -> None:
        """Apply the safe torque from now on, and engage the brakes."""
        self.ended = reason
        self._controller.give_up()
        self._robot.engage_brakes()

    def _write(self, torque: Array) -> None:
        """Write a torque (n,), which is finite and within the limits, or else zero and a safe stop."""
        if not np.all(np.abs(torque) <= self._max_torque):
            torque = np.zeros(self._n)
            if not self.ended:
                self._give_up("the law gave a torque beyond the limits")
        self._torque[:] = torque
        self._robot.write(self._torque)

    def _record(self, phase: Phase, position: Array, missed: int) -> None:
        """Put the period into the ring."""
        views, end = self._views, self._clock.now()
        is_new = self._last_sample == self._begin
        stamp = self._robot.sample_time if is_new else np.nan
        lateness, computation = self._lateness, end - self._begin
        views["period"][0], views["phase"][0], views["overrun"][0] = self._k, phase, 0.0
        views["period_start"][0], views["lateness"][0] = self._begin - self._origin, lateness
        views["computation_time"][0], views["sample_time"][0] = computation, stamp
        views["measured_position"][:] = position
        views["reference"][:], views["velocity_reference"][:], views["acceleration_reference"][:] = self._target
        views["torque"][:] = self._torque
        for place, values in self._signals:
            place[:] = values
        views["gain_changes"][0] = 0 if self._parts.changes is None else self._parts.changes.count
        views["assumption_flags"][0] = self._watch(position, stamp, is_new)
        self._parts.ring.append(self._row)
        if self._timed < self._times.shape[1]:
            self._times[:, self._timed] = lateness, computation
            self._timed += 1
        self._k += 1

    def _watch(self, position: Array, stamp: float, is_new: bool) -> int:
        """Return the flags of the certificate's assumptions."""
        watcher = self._parts.watcher
        if watcher is None:
            return 0
        time = stamp if np.isfinite(stamp) else self._begin
        elapsed = time - self._last_stamp if is_new else np.nan
        if is_new:
            self._last_stamp = time
        flags = watcher.step(position, self._target[0], self._velocity, self._torque, elapsed=elapsed)
        self.flags_seen |= int(flags)
        return int(flags)
