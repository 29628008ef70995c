"""Study: two laws on 64 robots.

Link mass, friction, load and encoder noise are drawn; both laws see the same draws.
The results lie in a folder from which an interrupted study goes on.
The figure shows the share of the runs below each RMS error.
"""

import matplotlib.pyplot as plt
import numpy as np

from tarc.study import Study

study = Study.parse(
    {
        "name": "loads",
        "scenario": "two_link_payload",
        "laws": [
            {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0},
            {
                "kind": "TARC",
                "inertia": {"fraction": 0.08},
                "natural_frequency": 15.0,
                "rise_rate": 4e3,
                "fall_rate": 2e3,
                "max_gain": 8.0,
            },
        ],
        "runs": 64,
        "sampling": "sobol",
        "draws": {
            "robot.masses.1": {"uniform": [0.8, 1.2]},
            "robot.viscous.0": {"normal": {"mean": 0.5, "deviation": 0.1, "low": 0.0}},
            "robot.viscous.1": {"normal": {"mean": 0.5, "deviation": 0.1, "low": 0.0}},
            "disturbance.0.mass": {"uniform": [0.0, 3.0]},
            "sensor.noise": {"log_uniform": [1e-6, 1e-4]},
        },
        "correlation": {"keys": ["robot.viscous.0", "robot.viscous.1"], "matrix": [[1, 0.6], [0.6, 1]]},
    }
)
result = study.run("loads.study", jobs=1)
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for law, rate in result.success_rate.items():
    low, median, high = 1e3 * result.quantiles("rms_error", [0.05, 0.5, 0.95])[law]
    print(f"{law:5} {rate:.0%} completed, RMS error {low:.2f} … {median:.2f} … {high:.2f} mrad (5 %, median, 95 %)")
    errors = np.sort(1e3 * result.data["rms_error"].sel(law=law).values)
    axes.step(errors, np.arange(1, len(errors) + 1) / len(errors), where="post", label=law)
axes.set(xlabel="RMS error [mrad]", ylabel="share of the runs", ylim=(0, 1))
axes.legend(frameon=False)
figure.savefig("study_of_loads.png", dpi=110)
print("drawn: study_of_loads.png; the results are in loads.study")
