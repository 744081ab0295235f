"""Hardware-in-the-loop style tests: the daemon on a bus, a plant and a vehicle around it, faults, and a verdict."""
