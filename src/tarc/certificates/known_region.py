"""The tube of a law with M̂(q): what its Lyapunov function must tolerate."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tarc.analysis.known_tube import KnownTube
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.region_form import InputBounds
from tarc.certificates.region_search import Disturbances, TubeCase, TubeSize
from tarc.core.types import Array
from tarc.laws.tde import TDE
from tarc.plants.base import Plant
from tarc.signals.references import Reference


class KnownRegion:
    """Tubes about a reference, for a law with M̂(q).

    Parameters
    ----------
    law, plants, reference, duration
        The law, the robot or several, the motion and its duration [s].
    limits
        Largest error of each joint, (n,).
    disturbances
        What acts on the robot.
    residuals
        r at each period, (n, k).
    sampling
        Number of sampled states, and the seed.
    room
        Factor on all that is found.
    """

    def __init__(
        self,
        law: TDE,
        plants: Sequence[Plant],
        reference: Reference,
        duration: float,
        limits: Array,
        disturbances: Disturbances,
        residuals: Array,
        sampling: tuple[int, int],
        room: float,
    ):
        samples, seed = sampling
        self._room, self._disturbances, self._residuals = room, disturbances, residuals
        self._tube = KnownTube(
            law=law,
            plants=plants,
            reference=reference,
            duration=duration,
            error=limits,
            error_rate=0 * limits,
            noise=disturbances.noise,
            samples=samples,
            seed=seed,
        )
        self.units = room * self._tube.units_of_joints()
        self.size = float((limits / self.units).min())
        self._tube = replace(self._tube, error=self.size * self.units)
        self.nominal_inertia = room * self._tube.start_inertia()

    def case(self, tube: TubeSize) -> TubeCase:
        """Return what the loop must tolerate in a tube of the errors `size`."""
        given, room, T = self._disturbances, self._room, self._tube.law.period
        within = replace(self._tube, error_rate=tube.error_rate * self.units)
        found = within.bounds(given.torque_rate, given.max_torque, given.friction, self._residuals)
        robot, count = found.robot, len(found.robot.stiffness)
        min_ratio, nominal_rate = robot.min_ratio / room, found.nominal_rate * room
        ratios = RatioSet(
            min_ratio=min_ratio,
            max_ratio=robot.max_ratio * room,
            rate=robot.relative_rate * room / min_ratio,
            relative_rate=robot.relative_rate * room,
            period=T,
            intersample=True,
            powers=np.ones(count),
            lead_times=robot.lead_times,
            stiffness=robot.stiffness * room,
            shares=np.full(count, given.force_share),
            nominal_rate=nominal_rate,
        )
        noise = room * found.noise
        bounds = InputBounds(
            noise=noise,
            residual=room * found.residual,
            change=room * (found.change + found.disturbance_change + ratios.max_nominal_change * found.disturbance),
            held=room * (found.held + found.disturbance_change),
            torque=room * (found.friction + found.own_stiffness * noise),
        )
        start = room * robot.rest_stiffness, room * found.start_torque, room * found.start_velocity
        return TubeCase(tube, ratios, bounds, start)
