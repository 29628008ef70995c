"""Controllers: sensor, law and delay in a simulation, and the law in real time."""
