"""Memory that the C library keeps for the next arrays."""

import ctypes
import platform

M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8
"""Parameters of glibc's ``mallopt``."""
KEPT = 1 << 28
"""Freed memory that is kept [bytes]; arrays of a study's runs are of some megabytes."""


def keep_freed_memory() -> bool:
    """Let the C library keep freed arrays of up to `KEPT` bytes for the next ones; return whether it does.

    By default glibc gives arrays of megabytes back to the system at once. Each new one is then mapped page by page,
    which takes a fifth of the time of a study in machine code. Other C libraries are left as they are.
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(M_MMAP_THRESHOLD, KEPT)) and bool(mallopt(M_TRIM_THRESHOLD, KEPT))


def limit_heaps(count: int) -> bool:
    """Let all threads share this many heaps of the C library; return whether they do.

    By default glibc gives each thread its own, and what one thread has freed serves no other. Call it before threads
    start. Other C libraries are left as they are.
    """
    return platform.libc_ver()[0] == "glibc" and bool(ctypes.CDLL(None).mallopt(M_ARENA_MAX, count))


def release_freed_memory() -> bool:
    """Give freed memory between used memory back to the system; return whether there was some.

    Other C libraries than glibc are left as they are.
    """
    return platform.libc_ver()[0] == "glibc" and bool(ctypes.CDLL(None).malloc_trim(0))
