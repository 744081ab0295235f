"""Makes a plant FMU without Python of a PyBaMM model and parameter set. Needs the `plant` extra and a C compiler."""
