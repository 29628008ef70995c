"""Gains that change while a loop runs, within what is certified."""

import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

from tarc.control.controller import Controller, PreparedLaw
from tarc.core.errors import InvalidParameter
from tarc.laws.pole_placement import PolePlacement
from tarc.runtime.law_preparer import LawPreparer
from tarc.signals.torque_limits import TorqueLimits

if TYPE_CHECKING:  # a machine that runs a law needs no solver
    from tarc.certificates.certified_gains import CertifiedGains, GainRange

POLL = 0.5e-3
"""Time between two looks whether the loop has taken a change [s]."""
SWITCH_INTERVAL = 5e-5
"""Longest time that a thread keeps the interpreter from the loop [s]."""
NOT_RUNNING = "gains: the loop does not run; give these changes to run_live(changes=…), and change gains meanwhile"


class GainChanges:
    """Changes of a law's gains while `run_live` runs it, from any other thread.

    A new law is traced and compiled in a process of its own, so that no period waits for it. The loop then exchanges
    the step between two periods and keeps the state. A law on time-delay estimation has its past torque as its memory.
    So a new natural frequency changes the torque at once by −M̂ (ΔK1 e1 + ΔK2 (v̂ − q̇ᵈ)) alone, which is zero without
    an error.

    Parameters
    ----------
    certified
        What `tarc.certificates.certify_gains` found.

    Attributes
    ----------
    law
        The law with the gains that run, or are about to.
    count
        Changes that the loop has taken.
    """

    def __init__(self, certified: "CertifiedGains"):
        self._certified = certified
        self.law: PolePlacement = certified.law
        self.count = 0
        self._pending: PreparedLaw | None = None
        self._controller: Controller | None = None
        self._preparer: LawPreparer | None = None
        self._record: Callable[[dict[str, float]], object] = lambda gains: None
        self._one_at_a_time = threading.Lock()

    @property
    def ranges(self) -> "dict[str, GainRange]":
        """Return the certified range of each gain, all others as they are now; empty where none may change."""
        return self._certified.ranges(self.law)

    @property
    def reason(self) -> str:
        """Return why no gain may change; empty where one may."""
        return self._certified.reason

    def change(self, *, wait: bool = True, **gains: float) -> None:
        """Change gains, such as ``natural_frequency=18.2``.

        Parameters
        ----------
        wait
            Return when the loop has taken the change, instead of when it is prepared.
        gains
            New values.

        Raises
        ------
        InvalidParameter
            For gains outside their certified range or without one, and where the loop does not run, or ends meanwhile.
        """
        with self._one_at_a_time:
            law = self._certified.change(self.law, gains)
            controller, preparer = self._controller, self._preparer
            if controller is None or preparer is None:
                raise InvalidParameter(NOT_RUNNING, "gains")
            prepared = controller.prepare(law, preparer.prepare(law))
            self._await_loop()
            self._record(dict(gains))
            self.law, self._pending = law, prepared
            if wait:
                self._await_loop()

    def _await_loop(self) -> None:
        """Wait until the loop has taken what is pending."""
        while self._pending is not None:
            if self._controller is None:
                raise InvalidParameter("gains: the loop ended before it took the change", "gains")
            time.sleep(POLL)

    def apply(self) -> None:
        """Take a pending change: the loop calls this between two periods."""
        prepared = self._pending
        if prepared is not None and self._controller is not None:
            self._controller.change_law(prepared)
            self.count += 1
            self._pending = None

    def start(
        self,
        controller: Controller,
        limits: TorqueLimits | None,
        record: Callable[[dict[str, float]], object],
    ) -> ExitStack:
        """Get ready for a loop; leave what is returned when it ends.

        Parameters
        ----------
        controller, limits
            That of the loop, and its torque limits.
        record
            Called with the gains of each change, before the loop takes it.

        Raises
        ------
        InvalidParameter
            For a controller of another law, and for changes that another loop has.
        """
        if self._controller is not None:
            raise InvalidParameter("changes: another loop has them; give each loop its own", "changes")
        if controller.law is not self._certified.law:
            raise InvalidParameter(
                "changes: their gains are certified for another law than that of the loop", "changes"
            )
        ending = ExitStack()
        self._preparer = ending.enter_context(LawPreparer(limits, controller.is_native))
        ending.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_INTERVAL)
        ending.callback(self._end)
        self.law, self.count, self._pending, self._record = self._certified.law, 0, None, record
        self._controller = controller
        return ending

    def _end(self) -> None:
        self._controller = self._preparer = None
