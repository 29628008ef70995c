"""The controller's side of the joint: in a simulation, and in real time."""
