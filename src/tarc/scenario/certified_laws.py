"""Certificates of the laws of a scenario, on the robot with each payload and schedule that it meets."""

from collections.abc import Sequence

from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Verdict
from tarc.certificates.known_inertia import certify_known_inertia
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence
from tarc.certification import LawCertification, certify_law
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.progress import Progress
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.plants.base import Plant
from tarc.scenario.parts import Setup

EXPECTED_PROGRAMS = 4
"""Semidefinite programs of a Lyapunov function that is affine in the inertia, for the progress bar."""


class CertifiedLaws(dict[str, LawCertification]):
    """Certifications of laws by name.

    Attributes
    ----------
    setup
        What the scenario built.
    plants, workspace, samples
        What they were certified for: the robot with each payload and schedule, postures and speeds, sampled postures.
    skipped
        Reasons by name of the laws to which no certificate applies.
    known_inertia
        Certificates of the laws with M̂(q), by name.
    laws_with_model
        These laws.
    """

    def __init__(self, setup: Setup, plants: Sequence[Plant], workspace: Workspace, samples: int) -> None:
        super().__init__()
        self.setup = setup
        self.plants = tuple(plants)
        self.workspace = workspace
        self.samples = samples
        self.skipped: dict[str, str] = {}
        self.known_inertia: dict[str, Certificate[KnownInertiaEvidence]] = {}
        self.laws_with_model: dict[str, Law] = {}

    def strengthen(self, progress: bool | None = None) -> dict[str, LawCertification]:
        """Try a Lyapunov function affine in the inertia for each law that is not certified with a margin.

        It takes seconds for each law. Where it is better, it replaces the certificate of the robot.

        Parameters
        ----------
        progress
            Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

        Returns
        -------
        dict
            The certifications that changed, by name; those of laws with M̂(q) change in ``known_inertia``.
        """
        changed = {}
        n_laws = len(self) + len(self.known_inertia)
        with Progress("affine Lyapunov function", EXPECTED_PROGRAMS * n_laws, progress) as bar:
            for name, certification in self.items():
                strengthened = certification.strengthened(
                    self.plants, self.workspace, samples=self.samples, on_program=bar.advance
                )
                if strengthened is not certification:
                    changed[name] = strengthened
            for name, certificate in self.known_inertia.items():
                if certificate.verdict == Verdict.INCONCLUSIVE:
                    self.known_inertia[name] = certify_known_inertia(
                        self.laws_with_model[name],
                        self.plants,
                        self.workspace,
                        computation_delay=certificate.evidence.computation_delay,
                        samples=self.samples,
                        on_program=bar.advance,
                    )
        self.update(changed)
        return changed

    def prove(self, time_limit: float = 600.0, progress: bool | None = None) -> None:
        """Prove the certificate of each law that is certified for every posture, by `LawCertification.proven`.

        Those of laws with M̂(q) rest on samples and search.

        Parameters
        ----------
        time_limit
            Time for each law after which its proof stops as it is [s].
        progress
            Show progress bars when it takes more than two seconds; None for when standard error is a terminal.

        Raises
        ------
        InvalidParameter
            For a robot whose equations are no trigonometric polynomials, as with joints that slide.
        KeyboardInterrupt
            For Ctrl-C; what was proven is kept.
        """
        for name, certification in self.items():
            if certification.verdict.certified:
                proven = certification.proven(self.plants, self.workspace, time_limit=time_limit, progress=progress)
                self[name] = proven


def certify_laws(
    setup: Setup,
    plants: Sequence[Plant],
    workspace: Workspace,
    computation_delay: int,
    *,
    samples: int,
    progress: bool | None,
) -> CertifiedLaws:
    """Certify every law of a scenario; `Scenario.certify` says how.

    Raises
    ------
    UnsupportedLaw, NotLinearisable
        Where no certificate applies to any of the laws.
    """
    certified = CertifiedLaws(setup, plants, workspace, samples)
    with Progress("certifying", 9 * len(setup.laws), progress) as bar:
        for name, law in setup.laws.items():
            try:
                if isinstance(getattr(law, "inertia", None), NominalInertia):
                    certified.known_inertia[name] = certify_known_inertia(
                        law, plants, workspace, computation_delay=computation_delay, samples=samples, quick=True
                    )
                    certified.laws_with_model[name] = law
                    continue
                certified[name] = certify_law(
                    law,
                    plants,
                    workspace,
                    computation_delay=computation_delay,
                    samples=samples,
                    others=tuple(certified.values()),
                    on_certificate=lambda _: bar.advance(),
                )
            except (UnsupportedLaw, NotLinearisable) as error:
                if len(setup.laws) == 1:
                    raise
                certified.skipped[name] = str(error)
    if not certified and not certified.known_inertia:
        raise UnsupportedLaw(f"law: no certificate applies to any. {' '.join(certified.skipped.values())}")
    return certified
