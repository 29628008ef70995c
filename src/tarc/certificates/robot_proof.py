"""The proof that a certified robot stays within what its certificate covers, in every posture of the workspace."""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.linearise import require_inertia
from tarc.analysis.workspace import Workspace
from tarc.certificates.affine_cover import with_fewest_bounds
from tarc.certificates.base import EVERY_POSTURE, Certificate
from tarc.certificates.bound_prover import BoundProver, BrokenBound, ProvenPart
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.core import validation as check
from tarc.core.formatting import format_vector
from tarc.laws.base import Law
from tarc.plants.base import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class ProvenRobot:
    """A certificate of a robot, and what of it is proven for every posture of the workspace.

    Attributes
    ----------
    certificate
        The certificate; where a posture breaks a bound, it is judged again with that posture.
    parts
        Its bounds.
    """

    certificate: Certificate[RobotEvidence]
    parts: tuple[ProvenPart, ...]

    @property
    def complete(self) -> bool:
        """Whether all bounds are proven, so that the verdict holds in every posture."""
        return bool(self.parts) and all(part.complete for part in self.parts)

    @property
    def share(self) -> float:
        """Share of the workspace in which all bounds are proven, at least that of the worst."""
        return min((part.share for part in self.parts), default=0.0)


def prove_robot(
    certificate: Certificate[RobotEvidence],
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    time_limit: float = 600.0,
    progress: bool | None = None,
) -> ProvenRobot:
    """Prove by branch and bound what a certified robot's verdict takes from samples and search.

    These are the bounds that its Lyapunov function or its ball covers, in every posture, at every speed and
    acceleration of the workspace. With J = M̂^−½ M M̂^−½ and K = M̂^−½ [G, D/θ] M̂^−½ each is a linear matrix inequality:

        1/ρmax ⪯ J ⪯ 1/ρmin,    ±J̇ ⪯ rate,    ±J̇ ⪯ relative rate · J,
        ‖E^−p [H, C/θ]‖ ≤ κ:  [J^{2−2p}, K/κ; Kᵀ/κ, I] ⪰ 0,
        α0 |k|² + α1 kᵀEk + 2 α2 ẋᵀk ≤ β0 |x|² + β1 |ẋ|²:  see `tarc.certificates.force_form`,
        ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ:  [2 ρ0 J − I, (ρ0² − δ²)^½ J, K/η; ·, I, 0; ·, 0, I] ⪰ 0.

    All but p = 0 are affine in M, G and D. So a robot with and one without its payload stand for every payload between.
    J and K are trigonometric polynomials of the posture, and K one of the speeds too: `tarc.analysis.motion_forces` has
    the corners of the motions. More than four joints that move have too many. Then gravity with acceleration, products
    of speeds, and damping are bounded by themselves, and another Lyapunov function is found that covers their sum. It
    needs a verdict by a Lyapunov function; with a ball these forces rest on search.

    These bounds are left out where their functions need more memory than `tarc.numerics.trig_polynomial.too_large`
    allows, as for seven joints. Its reason is then that of the part.

    What time or Ctrl-C ends goes on in the next call, from the folder of `tarc.analysis.stored_proof.proofs_folder`.

    Parameters
    ----------
    certificate
        A certified result of `certify_robot` or `strengthen_robot`; others are returned as they are.
    law, plant, workspace
        As they were for it.
    time_limit
        Time after which the proof stops as it is, with the share that it has proven [s]. A semidefinite program that
        has begun is ended first.
    progress
        Show progress bars when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For a robot whose equations are no trigonometric polynomials, as with joints that slide.
    KeyboardInterrupt
        For Ctrl-C; what was proven is kept.
    """
    deadline = time.monotonic() + check.number("time_limit", time_limit, 0, strict=True)
    if not certificate.certified:
        return ProvenRobot(certificate=certificate, parts=())
    law, plants = in_torque_units(require_inertia(law, "the robot certificate"), as_plants(plant))
    evidence = certificate.evidence
    if evidence.affine is not None:
        evidence = replace(evidence, affine=with_fewest_bounds(evidence.affine))
    workspace = workspace.for_joints(plants[0].joint_names)
    prover = BoundProver(plants, law.M, workspace, evidence, deadline, progress)
    try:
        parts = tuple(prover.parts())
    except BrokenBound as broken:
        verdict, margin, witness = broken.evidence.judge()
        line = f"the proof met a posture beyond what samples and search found: q = ({format_vector(broken.posture)})"
        judged = replace(
            certificate,
            evidence=broken.evidence,
            verdict=verdict,
            margin=margin,
            witness=witness,
            assumptions=(*certificate.assumptions, line),
        )
        return ProvenRobot(certificate=judged, parts=())
    if prover.evidence is not evidence:
        verdict, margin, witness = prover.evidence.judge()
        certificate = replace(certificate, verdict=verdict, margin=margin, witness=witness)
    result = ProvenRobot(certificate=replace(certificate, evidence=prover.evidence), parts=parts)
    return replace(result, certificate=_with_basis(result))


def _with_basis(proven: ProvenRobot) -> Certificate[RobotEvidence]:
    """Return the certificate with what is proven among its assumptions."""
    certificate = proven.certificate
    lines = [f"proven by branch and bound, with a bound on rounding: {part}" for part in proven.parts if part.complete]
    if not proven.complete:
        lines += [f"rests on samples and search: {part}" for part in proven.parts if not part.complete]
        basis = "; ".join([certificate.basis, *_shares(proven.parts)])
        return replace(certificate, basis=basis, assumptions=(*certificate.assumptions, *lines))
    assumptions = (re.sub(r"; so [^;]*samples and local search found", "", line) for line in certificate.assumptions)
    kept = [line for line in assumptions if "samples" not in line]
    return replace(certificate, basis=EVERY_POSTURE, assumptions=(*lines, *kept))


def _shares(parts: Sequence[ProvenPart]) -> list[str]:
    """Return which bounds are proven for every posture, and which for a share of them, in words."""
    complete = dict.fromkeys(part.name for part in parts if part.complete)
    begun = [f"{part.name} in {100 * min(part.share, 0.9999):.3g} %" for part in parts if 0 < part.share < 1]
    words = [f"proven for every posture: {', '.join(complete)}"] if complete else []
    return words + ([f"proven for a share of the postures: {', '.join(begun)}"] if begun else [])
