/* SPMe, parameter set Chen2020, generated with PyBaMM 26.10.1.1, CasADi 3.8.1: do not edit. */
#ifndef CELL_H
#define CELL_H

#define CELL_N_X 26

/* Inputs u: current (A, positive = discharge), ambient temperature (K), SoC at the start.
   Outputs: voltage (V), temperature (degC), SoC, then what has to stay above 0. */
#define CELL_N_U 3
#define CELL_N_ANSWERS 3
#define CELL_N_OUTPUTS 8
#define CELL_RANGE "a particle is empty or full, or the electrolyte is depleted"

#define CELL_SZ_ARG 2
#define CELL_SZ_RES 1
#define CELL_SZ_IW 1
#define CELL_SZ_W 59

int cell_initial(const double **arg, double **res, int *iw, double *w, int mem); /* u -> x */
int cell_rhs(const double **arg, double **res, int *iw, double *w, int mem);     /* x, u -> dx/dt */
int cell_outputs(const double **arg, double **res, int *iw, double *w, int mem); /* x, u -> outputs */
int cell_radius(const double **arg, double **res, int *iw, double *w, int mem);  /* x, u -> bound on the spectral radius of d(rhs)/dx, 1/s */

#endif
