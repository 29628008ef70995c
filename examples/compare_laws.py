"""Compare laws on one robot.

A TARC with gains of your own runs beside six tuned laws, on the same robot, reference and seed.
The figure shows accuracy against smoothness.
"""

import tarc
from tarc.study import compare, tuned_laws

scenario = tarc.Scenario.load("two_link_friction", ["duration=5.0"])
mine = {
    "kind": "TARC",
    "inertia": {"fraction": 0.06},
    "natural_frequency": 15.0,
    "rise_rate": 4e3,
    "fall_rate": 2e3,
    "max_gain": 8.0,
}
laws = {"mine": mine} | {name: tuned_laws()[name] for name in ("tarc", "tdc", "smc-tde", "asmc-tde", "adrc", "pid")}
found = compare(scenario, laws, jobs=1)
for name, one in sorted(found.measures.items(), key=lambda item: item[1]["rms_error"]):
    mark = "*" if name in found.front else " "
    print(f"{name:9}{mark} {1e3 * one['rms_error']:7.3f} mrad {one['torque_variation']:8.0f} N m/s")
found.plot("plane").savefig("compare_laws.png", dpi=110)
print("drawn: compare_laws.png; no law beats those marked * in both")
