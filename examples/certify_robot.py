"""Certify TARC on a UR5e that picks up 5 kg.

It finds the inertia shape that suits the path, tries five scales of it, and prints all certificates of one design.
The figure shows the verdict for the robot.
"""

from dataclasses import replace

import tarc
from tarc import certify_law
from tarc.analysis import Workspace, best_inertia_shape
from tarc.certificates import certify_robot

plants = [tarc.plants.load_robot("ur5e", armature=0.1, payload=mass) for mass in (0.0, 5.0)]
reference = tarc.Scenario.load("ur5e").build_reference()
workspace = Workspace.from_reference(reference, 20.0, tube=0.01)
shape, spread = best_inertia_shape(plants, workspace)
print(f"the inertia that suits the path best leaves a spread of {spread:.1f}")

law = tarc.laws.TARC(
    inertia=0.1 * shape,
    natural_frequency=20.0,
    period=1e-3,
    estimator=tarc.estimators.Algebraic(window=0.004, degree=2),
    synchronised=True,
    rise_rate=1e4,
    fall_rate=5e3,
    boundary_layer=0.015,
    max_gain=6.4,
)
for share in (0.02, 0.05, 0.1, 0.2, 0.4):
    verdict = certify_robot(replace(law, inertia=share * shape), plants, workspace)
    print(f"{share:4} of it: {verdict.verdict}, margin {verdict.margin:.3f}")

for kind, certificate in certify_law(law, plants, workspace).certificates.items():
    grade = "ball arithmetic" if certificate.proof_grade else "floating point"
    print(f"{kind:9} {certificate.verdict:13} {certificate.margin:8.3g}  {grade}")
    if kind == "robot":
        certificate.plot().savefig("certify_robot.png", dpi=110)
