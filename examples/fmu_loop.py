"""A law as an FMU, in a loop with a robot that another program simulates.

FMPy runs the FMU both ways, against a two-link arm that Python integrates.
In co-simulation each torque acts one period late, by the standard; in model exchange at once.
"""

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave

import tarc

arm = tarc.plants.TwoLinkArm(viscous=[0.5, 0.5])
law = tarc.laws.TDC(
    inertia=0.15 * arm.inertia(np.array([0.0, 1.5])),
    natural_frequency=15.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.010),
)
tarc.export.export_fmu(law, "arm.fmu")
description = read_model_description("arm.fmu")
places = {}  # value references of all elements by the name of the array
for variable in description.modelVariables:
    places.setdefault(variable.name.split("[")[0], []).append(variable.valueReference)


def integrate(q, dq, torque, h=law.period):
    """Return the state after a period with the torque held, by Runge and Kutta."""

    def rate(x):
        return np.concatenate([x[2:], arm.evaluate("acceleration", x[:2], x[2:], torque)])

    x = np.concatenate([q, dq])
    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    k4 = rate(x + h * k3)
    x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x[:2], x[2:]


def errors(kind, periods=1000):
    """Return the error in each period of co-simulation or model exchange."""
    fmu = kind(
        guid=description.guid,
        unzipDirectory=extract("arm.fmu"),
        modelIdentifier="arm",
        instanceName="law",
    )
    start = np.array([0.0, 1.5])
    q, dq, found = start, np.zeros(2), []
    fmu.instantiate()
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.setReal(places["initial_torque"], arm.holding_torque(start).tolist())  # as the brakes hand it over
    fmu.exitInitializationMode()
    for k in range(periods):
        t = k * law.period
        swing, rate = np.array([0.3, 0.25]), np.array([2.0, 4.6])
        references = {
            "position": q,
            "reference": start + swing * (1 - np.cos(rate * t)),
            "velocity_reference": swing * rate * np.sin(rate * t),
            "acceleration_reference": swing * rate**2 * np.cos(rate * t),
        }
        found.append(q - references["reference"])
        torque = np.array(fmu.getReal(places["torque"]))  # of the sample before
        if kind is FMU2Model and k:
            fmu.setTime(t)
            fmu.enterEventMode()
        for name, values in references.items():
            fmu.setReal(places[name], values.tolist())
        if kind is FMU2Slave:
            fmu.doStep(t, law.period)
        else:
            while fmu.newDiscreteStates()[0]:
                pass
            fmu.enterContinuousTimeMode()
            torque = np.array(fmu.getReal(places["torque"]))  # of this sample
        q, dq = integrate(q, dq, torque)
    fmu.terminate()
    fmu.freeInstance()
    return 1e3 * np.array(found)


figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for label, kind in {"co-simulation": FMU2Slave, "model exchange": FMU2Model}.items():
    found = errors(kind)
    print(f"{label}: largest error {np.abs(found).max():.3f} mrad")
    axes.plot(law.period * np.arange(len(found)), found[:, 0], "--" if kind is FMU2Model else "-", label=label)
axes.set(xlabel="time [s]", ylabel="error of the first joint [mrad]")
axes.legend()
figure.savefig("fmu_loop.png", dpi=110)
