"""Bytes of messages as a faulty network delivers them."""

import numpy as np

WORDS = (b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\0\0\xf0\x7f", b"\0\0\0\0")
"""Four bytes that are absurd as a length, or a part of an infinite or tiny number."""


def damaged(rng: np.random.Generator, message: bytes) -> bytes:
    """Return a message as it is, cut, changed in a byte or a word, or random."""
    data = bytearray(message)
    choice = rng.integers(0, 5)
    if choice == 0:
        data[rng.integers(0, len(data))] = rng.integers(0, 256)
    elif choice == 1:
        data = data[: rng.integers(0, len(data))]
    elif choice == 2:
        data = bytearray(rng.bytes(int(rng.integers(0, 120))))
    elif choice == 3:
        place = 4 * int(rng.integers(0, len(data) // 4))
        data[place : place + 4] = WORDS[rng.integers(0, len(WORDS))]
    return bytes(data)
