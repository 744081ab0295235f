#ifndef STATE_H
#define STATE_H

#include "spme_casadi.h"
#include "variables.h"

typedef struct {
    double value[N_VARIABLES];
    double x[SPME_N_X]; /* particle stoichiometries, porosity times electrolyte concentration, temperature; scaled to ~1 */
    double step_s;      /* the integrator's next trial step */
} Model;

#endif
