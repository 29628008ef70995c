"""Memory that the C library keeps."""

import platform
import subprocess
import sys

COMMAND = "from tarc.core.allocator import keep_freed_memory; print(keep_freed_memory())"


def test_it_says_whether_memory_is_kept():
    said = subprocess.run([sys.executable, "-c", COMMAND], capture_output=True, text=True, check=True).stdout
    assert said.strip() == str(platform.libc_ver()[0] == "glibc")
