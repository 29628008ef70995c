"""How long a user waits before anything happens."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.measure import Row


def startup() -> list[Row]:
    """Medians of five fresh processes each, in turns with a Python that does nothing."""
    tarc = str(Path(sys.executable).with_name("tarc"))
    jobs = {"pass": [sys.executable, "-c", "pass"], "import tarc": [sys.executable, "-c", "import tarc"]}
    if Path(tarc).is_file():
        jobs["tarc --help"] = [tarc, "--help"]
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(5):
        for name, job in jobs.items():
            begin = time.perf_counter()
            subprocess.run(job, check=True, stdout=subprocess.DEVNULL)
            times[name].append(time.perf_counter() - begin)
    took = {name: float(np.median(values)) for name, values in times.items()}
    against = f"python -c pass: {took['pass']:.3f} s"
    return [
        Row(name, f"{took[name]:.3f} s", against, None, f"≤ {limit} s", took[name] <= limit)
        if name in took
        else Row(name, "not installed", target=f"≤ {limit} s")
        for name, limit in (("import tarc", 0.3), ("tarc --help", 0.6))
    ]
