"""Proofs by branch and bound that go on where an earlier run of the same question ended."""

import hashlib
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tarc.core.codegen import cache
from tarc.core.files import writing
from tarc.core.progress import Progress
from tarc.numerics.eigenvalue_proof import Boxes, Proof, prove_below
from tarc.numerics.trig_polynomial import TrigPolynomial

VERSION = "1"
"""Changed with every change of the bounds, so that older files count no more."""
SAVE_PERIOD = 10.0
"""Time between two saves of the open boxes [s]."""
MIN_SAVED_TIME = 1.0
"""Time that a proof must have taken to be saved [s]."""
DIGITS = 13
"""Digits of the coefficients that make two robots different; smaller differences are in the bounds' allowance."""
STEPS = 1000
"""Steps of the progress bar."""


def proofs_folder() -> Path:
    """Return the folder of proofs: ``$XDG_CACHE_HOME/tarc/proofs``, by default ``~/.cache/tarc/proofs``."""
    return cache() / "proofs"


def prove_stored(
    functions: Sequence[TrigPolynomial],
    bounds: Sequence[float],
    boxes: Boxes,
    *,
    label: str,
    time_limit: float = np.inf,
    progress: bool | None = None,
) -> Proof:
    """Prove that eigenvalues stay below bounds as `prove_below` does, from where an earlier run ended.

    What is left is saved every ten seconds, at the end and on Ctrl-C, which then goes on as `KeyboardInterrupt`. The
    file's name is a hash of the polynomials, the bounds and the boxes. So another robot, workspace or bound begins
    anew. A proof that was completed is found again at once.

    Parameters
    ----------
    functions, bounds, boxes, time_limit
        As in `prove_below`.
    label
        What is proven, for the progress bar.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    KeyboardInterrupt
        For Ctrl-C, once the open boxes are saved.
    InvalidParameter
        For a folder that cannot be written.
    """
    file = proofs_folder() / f"{_name(functions, bounds, boxes)}.npz"
    open_boxes, before = _read(file, len(functions), functions[0].n_angles)
    start = saved = time.monotonic()
    with Progress(label, STEPS, progress) as bar:

        def report(share: float, left: list[Boxes], n_boxes: int) -> None:
            nonlocal saved
            bar.advance(max(int(STEPS * share) - bar.done, 0))
            if time.monotonic() - saved > SAVE_PERIOD:
                _write(file, left, before + n_boxes)
                saved = time.monotonic()

        proof = prove_below(functions, bounds, boxes, time_limit=time_limit, on_progress=report, open_boxes=open_boxes)
    proof = proof._replace(n_boxes=before + proof.n_boxes)
    if proof.counterexample is not None:
        file.unlink(missing_ok=True)
    elif proof.interrupted or time.monotonic() - start > MIN_SAVED_TIME:
        _write(file, proof.open_boxes, proof.n_boxes)
    if proof.interrupted:
        raise KeyboardInterrupt
    return proof


def _name(functions: Sequence[TrigPolynomial], bounds: Sequence[float], boxes: Boxes) -> str:
    """Return the hash of a question."""
    digest = hashlib.sha256(VERSION.encode())
    for function in functions:
        scale = max(
            float(np.abs(function.cosines).max(initial=0)), float(np.abs(function.sines).max(initial=0)), 1e-300
        )
        digest.update(repr((function.modes.shape, function.cosines.shape, f"{scale:.{DIGITS - 1}e}")).encode())
        digest.update(np.ascontiguousarray(function.modes, dtype=np.int64).tobytes())
        for part in (function.cosines, function.sines):
            digest.update(np.rint(part / scale * 10**DIGITS).astype(np.int64).tobytes())
    for numbers in (bounds, *boxes):
        digest.update(repr(np.shape(numbers)).encode())
        digest.update(np.ascontiguousarray(numbers, dtype=float).tobytes())
    return digest.hexdigest()[:32]


def _read(file: Path, n_functions: int, n_angles: int) -> tuple[list[Boxes] | None, int]:
    """Return the open boxes of each function and the number of boxes that were looked at; None for no such file."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
            counts, n_boxes = content["counts"], int(content["n_boxes"])
            centres, half_widths = content["centres"], content["half_widths"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):  # none, or one that was cut off
        return None, 0
    shape = (int(counts.sum()), n_angles)
    if len(counts) != n_functions or centres.shape != shape or half_widths.shape != shape:
        return None, 0
    ends = np.cumsum(counts)[:-1]
    return list(zip(np.split(centres, ends), np.split(half_widths, ends), strict=True)), n_boxes


def _write(file: Path, open_boxes: Sequence[Boxes], n_boxes: int) -> None:
    """Write the open boxes, in one step, so that a file is never half written."""
    with writing("cache", file):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{time.monotonic_ns()}.part")
        with part.open("wb") as stream:
            np.savez(
                stream,
                counts=np.array([len(c) for c, _ in open_boxes]),
                centres=np.concatenate([c for c, _ in open_boxes]),
                half_widths=np.concatenate([h for _, h in open_boxes]),
                n_boxes=np.array(n_boxes),
            )
        part.replace(file)
