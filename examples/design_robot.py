"""Design a controller for a UR5e that carries up to 5 kg.

Two designs differ in the greatest speed of the joints: 1 rad/s and 0.5 rad/s.
The slower the robot, the less torque noise it takes to certify the gains.
The figure shows all loops that were assessed for the slower one.
"""

import tarc

arm = tarc.plants.load_robot("ur5e", armature=0.1)
designs = {}
for speed in (1.0, 0.5):
    made = tarc.design.design_controller(arm, payload=(0.0, 5.0), sensor=tarc.signals.Encoder(bits=17), speed=speed)
    run = next(iter(made.scenario().run().values()))
    found = run.metrics(start_time=1.0)
    loop, verdict = made.candidate, made.certificates["robot"].verdict
    print(
        f"up to {speed:g} rad/s: {verdict}, natural frequency {loop.natural_frequency:.3g} rad/s, window "
        f"{loop.window} ms"
    )
    print(f"    RMS error {1e3 * found['rms_error']:.3g} mrad at {found['torque_variation']:.0f} N m/s")
    designs[speed] = made

slow = designs[0.5]
slow.plot("front").savefig("design_robot.png", dpi=110)
slow.plot("reach").savefig("stability_map.png", dpi=110)
for answer in tarc.design.stress_test(slow, questions=("payload",)).values():
    print(answer.explain())
