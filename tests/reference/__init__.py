"""Independent references for the tests and the benchmarks.

Nothing here uses the matrices of a certificate. The loops are recurrences written by hand from the equations of the
laws, with weights from least squares of their own, and the adversaries choose what the certificates say may vary:
the mismatch E(t) within its ball, at any speed or within a rate, alone or with a stiffness H(t) of the robot, in two
dimensions, and the slope κ(t) of the robust term.
"""
