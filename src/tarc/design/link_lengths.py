"""Robots whose links may be shorter or longer: which of them a certificate must have."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.certificates.known_inertia_evidence import KnownInertiaEvidence
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant

N_POSTURES = 200
"""Number of sampled postures at which robots are compared."""
MAX_PLANAR_LINKS = 3
"""Largest number of links of a planar arm, which counts shorter, as it is and longer."""
MAX_LINKS = 8
"""Largest number of links of a robot from a file, whose ends are compared at each posture."""
MAX_DIP = 0.02
"""Largest share by which the inertia between the ends may be below that at the ends; a part of a search's margin."""


def robots_with_lengths(robots: Sequence[Plant], share: float, workspace: Workspace, seed: int) -> list[Plant]:
    """Return the robots that stand for all whose links are shorter or longer, each by at most a share.

    For a planar arm these have each link shorter, as it is and longer. Its parameters are lengths and centres.

    A robot from a file has a factor per link, and so 2^n ends. They are compared at sampled motions of the workspace.
    The robots are those given, and of the ends those with the smallest and largest eigenvalue of M₀⁻¹M, and the largest
    ‖M₀^−½ G M₀^−½‖ and ‖M₀^−½ D M₀^−½‖. M₀ is the inertia of the first robot.

    xᵀMx sums squares of speeds that are linear in the factors s, and terms without them, so M is convex in s. So
    eigenvalues are largest at an end. Between the ends M is above its tangent at s = 1, which at an end v = 1 ± δ is
    below M(v) by the dip (M(v) + M(2 − v))/2 − M(1). That is of second order in the share δ.

    Parameters
    ----------
    robots
        Robots of other payload, rotor inertia and masses.
    share
        δ, such as 0.02 for 2 %.
    workspace
        The motions, with speeds and accelerations for a robot from a file.
    seed
        Of the samples.

    Raises
    ------
    InvalidParameter
        For too many links, for robots without lengths, and for a share so large that the dip exceeds `MAX_DIP`.
    """
    names, n = robots[0].parameters, robots[0].n_joints
    if "length_factors" not in names:
        return [arm for robot in robots for arm in _planar_arms(robot, share)]
    if n > MAX_LINKS:
        raise InvalidParameter(
            f"length_error: got a robot of {n} links, whose lengths have {2**n} ends; needs at most {MAX_LINKS}",
            "length_error",
        )
    motion = _motions(workspace, seed)
    scale = _inverse_roots(robots[0].linearised_at(*motion)[0])
    ends = [1 + share * np.array(signs) for signs in product((-1.0, 1.0), repeat=n)]
    chosen: dict[int, tuple[float, Plant]] = {}
    for robot in robots:
        found = [robot.with_parameters({"length_factors": end}) for end in ends]
        inertias = []
        for end in found:
            M, D, G = (scale @ part @ scale for part in end.linearised_at(*motion))
            inertias.append(M)
            values = np.linalg.eigvalsh(M)
            norms = (float(np.linalg.norm(part, 2, axis=(1, 2)).max()) for part in (G, D))
            for place, value in enumerate((-values.min(), values.max(), *norms)):
                if place not in chosen or value > chosen[place][0]:
                    chosen[place] = float(value), end
        _check_dip(scale @ robot.linearised_at(*motion)[0] @ scale, inertias, share)
    worst = {id(end): end for _, end in chosen.values()}
    return [*robots, *worst.values()]


def with_lengths(
    certificate: Certificate[KnownInertiaEvidence], robot: Plant, share: float
) -> Certificate[KnownInertiaEvidence]:
    """Return a certificate of `robots_with_lengths` whose verdict and assumptions say on which lengths it rests.

    Parameters
    ----------
    certificate
        The certificate.
    robot
        One of the robots.
    share
        As there; without one the certificate is returned as it is.
    """
    if not share:
        return certificate
    lengths = f"link lengths within {share:.3g} of their own, each by itself"
    if "length_factors" in robot.parameters:
        chosen = f"ends of {robot.n_joints} link lengths chosen at {N_POSTURES} sampled motions"
        line = f"{lengths}: of their {2**robot.n_joints} ends those with the extreme inertia, stiffness and damping at "
        line += f"{N_POSTURES} sampled motions are certified; other ends, and lengths between, are left to the margin"
    else:
        chosen = "each link shorter, as it is and longer"
        line = f"{lengths}: each link shorter, as it is and longer is certified; lengths between are left to the margin"
    basis = f"{certificate.basis}; {chosen}"
    return replace(certificate, basis=basis, assumptions=(*certificate.assumptions, line))


def _planar_arms(arm: Plant, share: float) -> list[Plant]:
    """Return a planar arm with each link shorter, as it is and longer."""
    n = arm.n_joints
    if n > MAX_PLANAR_LINKS:
        raise InvalidParameter(
            f"length_error: got an arm of {n} links, whose lengths have {3**n} combinations; needs at most "
            f"{MAX_PLANAR_LINKS}",
            "length_error",
        )
    lengths, centres = (np.broadcast_to(np.asarray(arm.parameters[name]), n) for name in ("lengths", "centres"))
    factors = [np.array(row) for row in product((1 - share, 1.0, 1 + share), repeat=n)]
    return [arm.with_parameters({"lengths": row * lengths, "centres": row * centres}) for row in factors]


def _motions(workspace: Workspace, seed: int) -> tuple[Array, Array, Array]:
    """Return postures, and speeds and accelerations at their limits, each (n, k)."""
    q = workspace.sample(N_POSTURES, seed).T
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (2, *q.shape))
    speed, acceleration = (np.asarray(part, dtype=float) for part in (workspace.speed, workspace.acceleration))
    return q, signs[0] * speed[:, None], signs[1] * acceleration[:, None]


def _inverse_roots(inertias: Array) -> Array:
    """Return M^−½ of k matrices, (k, n, n)."""
    values, vectors = np.linalg.eigh(inertias)
    return (vectors * values[:, None] ** -0.5) @ vectors.transpose(0, 2, 1)


def _check_dip(middle: Array, ends: Sequence[Array], share: float) -> None:
    """Refuse a share for which the inertia between the ends may be too far below that at the ends."""
    pairs = zip(ends, reversed(ends), strict=True)
    roots = _inverse_roots(middle)
    dip = max(float(np.linalg.eigvalsh(roots @ ((a + b) / 2 - middle) @ roots).max()) for a, b in pairs)
    if dip > MAX_DIP:
        raise InvalidParameter(
            f"length_error: got {share:g}; between its ends the inertia may be {dip:.1%} smaller than at them, which "
            f"is more than the {MAX_DIP:.0%} that a certificate's margin leaves to it; needs at most "
            f"{share * (MAX_DIP / dip) ** 0.5:.2g}",
            "length_error",
        )
