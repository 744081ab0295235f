/* Cells in series that share a current; the equations of one are in cell.c.

   A cell k of capacity_factor c and resistance_ohm r is c times the cell of the equations in parallel, so that it takes
   the current I / c, with a resistance r in series: v = v_cell(I / c) - r I. Its ambient temperature is the common one
   plus its ambient_offset_K. */
#include "model.h"

#include "rkc.h"

#include <math.h>
#include <stddef.h>

/* Of one integrator step. */
static const double TOLERANCE = 1e-5;

typedef struct {
    double u[CELL_N_U];
} Inputs;

typedef int Generated(const double **arg, double **res, int *iw, double *w, int mem);

/* A generated function of up to two arguments, with the scratch memory it needs. */
static void call(Generated *function, const double *first, const double *second, double *result)
{
    const double *arg[CELL_SZ_ARG] = {first, second};
    double *res[CELL_SZ_RES] = {result}, w[CELL_SZ_W];
    int iw[CELL_SZ_IW];
    function(arg, res, iw, w, 0);
}

static Inputs inputs(const Model *m, int cell)
{
    const double *value = m->value;
    return (Inputs){{
        value[CURRENT_A] / value[CAPACITY_FACTOR + cell],
        value[AMBIENT_DEGC] + value[AMBIENT_OFFSET_K + cell] + 273.15,
        value[SOC_INITIAL] + value[SOC_OFFSET + cell],
    }};
}

static void rhs(const void *u, const double *x, double *dxdt)
{
    call(cell_rhs, x, u, dxdt);
}

static double radius(const void *u, const double *x)
{
    double bound;
    call(cell_radius, x, u, &bound);
    return bound;
}

const char *model_initialise(Model *m)
{
    for (int cell = 0; cell < N_CELLS; ++cell) {
        const Inputs in = inputs(m, cell);
        if (!(in.u[2] >= 0.0 && in.u[2] <= 1.0)) {
            return "soc_initial + soc_offset is not within [0, 1]";
        }
        call(cell_initial, in.u, NULL, m->x[cell]);
        m->step_s[cell] = 1.0;
    }
    return NULL;
}

const char *model_step(Model *m, double duration)
{
    const Rkc ode = {CELL_N_X, rhs, radius, TOLERANCE};
    double work[RKC_WORK(CELL_N_X)];
    for (int cell = 0; cell < N_CELLS; ++cell) {
        const Inputs in = inputs(m, cell);
        if (rkc_advance(&ode, &in, duration, m->x[cell], &m->step_s[cell], work) != 0) {
            return "the equations have no finite solution over this step";
        }
    }
    return NULL;
}

const char *model_outputs(Model *m)
{
    for (int cell = 0; cell < N_CELLS; ++cell) {
        const Inputs in = inputs(m, cell);
        double out[CELL_N_OUTPUTS];
        call(cell_outputs, m->x[cell], in.u, out);
        for (int k = CELL_N_ANSWERS; k < CELL_N_OUTPUTS; ++k) {
            if (!(out[k] > 0.0)) {
                return "the cell is outside the model's range: " CELL_RANGE;
            }
        }
        if (!isfinite(out[0])) {
            return "the voltage is not finite";
        }
        m->value[VOLTAGE_V + cell] = out[0] - m->value[RESISTANCE_OHM + cell] * m->value[CURRENT_A];
        m->value[TEMPERATURE_DEGC + cell] = out[1];
        m->value[SOC + cell] = out[2];
    }
    return NULL;
}
