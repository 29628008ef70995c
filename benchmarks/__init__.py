"""How fast it is: ``python -m benchmarks`` measures everything in one run and prints one table.

Ratios are of times that are taken in turns in the same run. So a slow or shared machine slows both. Times of calls are
the least of several repetitions, ratios the median over the turns.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))  # for the references that the tests share
