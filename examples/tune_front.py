"""Find the front of accuracy and smoothness of a law.

Each trial has a certificate for the robot's inertia ratios, and gains without a margin of 20 % are left out.
The figure shows the front, and below it the error of the best linear controller at each torque variation.
"""

import tarc
from tarc.plotting.tuning import front_figure
from tarc.study import TuningOptions, default_search_spaces, torque_variation_budget, tune_front

scenario = tarc.Scenario.load("train_two_link", ["duration=2.0", "metrics_start=0.5"])
limit = torque_variation_budget(scenario).total
front = tune_front(default_search_spaces()["tdc"], [scenario], [limit], TuningOptions(trials=90, margin=0.2))
for number, point in enumerate(front.points, 1):
    mark = "*" if point is front.knee else " "
    accuracy = f"{1e3 * point.rms_error:7.3f} mrad {point.torque_variation:8.0f} N m/s"
    print(f"{number:2}{mark} {accuracy}, margin {point.margin:.2f}")
front_figure({"tdc": front}, scenario.name, ("rad", "N m/s")).savefig("tune_front.png", dpi=110)

best = tarc.Scenario.parse({**scenario.model_dump(), "law": front.knee.law})
print(best.certify()["TDC"].verdict.verdict_in_words, "along the reference by tarc certify; drawn: tune_front.png")
