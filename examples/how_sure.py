"""From runs to claims with intervals.

A small study says how often each law is within a limit, how large its error is, and which law has less of it.
A search finds the worst draws, and a report explains all of it in one file.
The figure shows the share of the runs up to each error, with the interval of the median.
So few runs do not bound the higher quantiles from above.
"""

from tarc.plotting.study import distribution_figure
from tarc.study import Study, find_worst_case

common = {"inertia": 0.05, "natural_frequency": 10.0}
adaptive = {"rise_rate": 4000.0, "fall_rate": 2000.0, "boundary_layer": 0.01, "max_gain": 6.0}
study = Study.parse(
    {
        "name": "pendulum",
        "scenario": {
            "robot": {"kind": "Pendulum"},
            "law": [{"kind": "TDC", **common}, {"kind": "TARC", **common, **adaptive}],
            "estimator": {"kind": "Algebraic", "window": 0.010},
            "reference": {"kind": "Sinusoid", "amplitude": [0.5], "frequency": 2.0},
            "duration": 1.0,
            "substeps": 1,
        },
        "draws": {
            "robot.payload": {"uniform": [0.0, 1.0]},
            "robot.viscous": {"normal": {"mean": 0.5, "deviation": 0.1, "low": 0.0}},
            "sensor.noise": {"log_uniform": [1e-6, 1e-4]},
        },
        "runs": 32,
    }
)
result = study.run("pendulum.study", jobs=1)
summary = result.summary(limits={"rms_error": 0.02})
for law, share in summary.success.items():
    print(f"{law}: {100 * share.estimate:.0f} % within 20 mrad ({100 * share.low:.1f} to {100 * share.high:.1f} %)")
for law, by_probability in summary.quantiles["rms_error"].items():
    median = by_probability[0.5]
    print(f"{law}: median error {1e3 * median.estimate:.2f} mrad ({1e3 * median.low:.2f} to {1e3 * median.high:.2f})")
for comparison in summary.comparisons["rms_error"]:
    ratio = comparison.ratio
    print(f"{comparison.law} over {comparison.reference}: {ratio.low:.3g} to {ratio.high:.3g}, {comparison.verdict}")
worst = find_worst_case(study, result, law="TDC", generations=2)
print("worst draws:", {key: f"{value:.6g}" for key, value in worst.draws.items()})
print("report:", result.report(more=[worst.section()]))
errors = {law: summary.values["rms_error"][:, place] for place, law in enumerate(summary.laws)}
distribution_figure(errors, summary.quantiles["rms_error"], "RMS error [rad]").savefig("how_sure.png", dpi=110)
