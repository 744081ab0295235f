/* The state of a plant of cells in series; cell.h is generated with the equations of the cell. */
#ifndef STATE_H
#define STATE_H

#include "cell.h"
#include "variables.h"

enum { N_CELLS = VOLTAGE_V_ELEMENTS };

typedef struct {
    double value[N_VALUES];
    double x[N_CELLS][CELL_N_X]; /* concentrations as shares of their largest, temperature, ...: scaled to about 1 */
    double step_s[N_CELLS];      /* the integrator's next trial step */
} Model;

#endif
