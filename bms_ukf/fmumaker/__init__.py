"""Makes co-simulation FMUs, of FMI 2.0 and 3.0, of models in C: one table of variables, one model, no Python inside."""
