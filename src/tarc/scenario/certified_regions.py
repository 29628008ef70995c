"""Certified regions of attraction of the laws of a scenario, along its reference."""

from dataclasses import replace

import numpy as np

from tarc.certificates.base import Certificate
from tarc.certificates.region import certify_region, dry_friction
from tarc.certificates.region_evidence import RegionEvidence
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.progress import Progress
from tarc.core.validation import Numbers
from tarc.scenario.parts import Setup
from tarc.simulation.sampled_inputs import scheduled_plants

NOISE_DEVIATIONS = 5
"""Standard deviations of an encoder's noise up to which a measured position may be off."""


class CertifiedRegions(dict[str, Certificate[RegionEvidence]]):
    """Certificates of regions of attraction by the name of the law, and the laws that none covers.

    Attributes
    ----------
    skipped
        Reasons by name.
    """

    def __init__(self) -> None:
        super().__init__()
        self.skipped: dict[str, str] = {}


def certify_regions(
    setup: Setup,
    duration: float,
    computation_delay: int,
    *,
    max_error: Numbers,
    torque_rate: Numbers,
    samples: int,
    progress: bool | None,
) -> CertifiedRegions:
    """Certify the region of attraction of every law of a scenario; `Scenario.certify_regions` says how.

    Raises
    ------
    UnsupportedLaw, NotLinearisable
        Where none of the laws is covered.
    InvalidParameter
        For numbers out of range, and a robot that is not in symbols.
    """
    plants = [plant for start, plant in scheduled_plants(setup.plant, setup.events) if start < duration]
    sensor, n = setup.sensor, setup.plant.n_joints
    measured = np.zeros(n) + sensor.step_size / 2 + NOISE_DEVIATIONS * np.asarray(sensor.noise)
    friction = np.max([dry_friction(plant) for plant in plants], axis=0)
    regions = CertifiedRegions()
    with Progress("region of attraction", len(setup.laws), progress) as bar:
        for name, law in setup.laws.items():
            try:
                regions[name] = certify_region(
                    replace(law, torque_limit=None),
                    plants,
                    setup.reference,
                    duration,
                    max_error=max_error,
                    measurement_error=measured,
                    torque_rate=torque_rate,
                    friction=friction,
                    computation_delay=computation_delay,
                    samples=samples,
                )
            except (UnsupportedLaw, NotLinearisable) as error:
                if len(setup.laws) == 1:
                    raise
                regions.skipped[name] = str(error)
            bar.advance()
    if not regions:
        raise UnsupportedLaw(f"law: certify_region covers none. {' '.join(regions.skipped.values())}")
    return regions
