"""Memory that the C library keeps."""

import platform
import subprocess
import sys

COMMAND = "from tarc.core.allocator import keep_freed_memory; print(keep_freed_memory())"


def test_it_says_whether_memory_is_kept():
    said = subprocess.run([sys.executable, "-c", COMMAND], capture_output=True, text=True, check=True).stdout
    assert said.strip() == str(platform.libc_ver()[0] == "glibc")


CYCLE = """
import threading
from tarc.core.allocator import limit_heaps, release_freed_memory
def held():
    lines = open("/proc/self/status").read().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024
limits = limit_heaps(1)
kept = []
def fill():
    parts = [bytearray(10_000) for _ in range(5_000)]
    kept.append(parts[-1])  # the heap cannot shrink from its end
thread = threading.Thread(target=fill)
thread.start()
thread.join()
before = held()
print(limits, release_freed_memory(), before - held() > 40)
"""


def test_memory_that_threads_freed_goes_back_to_the_system():
    said = subprocess.run([sys.executable, "-c", CYCLE], capture_output=True, text=True, check=True).stdout
    is_glibc = platform.libc_ver()[0] == "glibc"
    assert said.split() == [str(is_glibc)] * 3
