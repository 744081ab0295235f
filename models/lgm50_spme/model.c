/* The LG M50 as PyBaMM's single-particle model with electrolyte; the equations are in README.md. */
#include "model.h"

#include "rkc.h"

#include <math.h>
#include <stddef.h>

/* Of one integrator step; README.md shows what it does to the voltage. */
static const double TOLERANCE = 1e-5;

typedef struct {
    double u[SPME_N_U];
} Inputs;

static Inputs inputs(const Model *m)
{
    return (Inputs){{m->value[CURRENT_A], m->value[AMBIENT_DEGC] + 273.15, m->value[SOC_INITIAL]}};
}

static void rhs(const void *u, const double *x, double *dxdt)
{
    spme_rhs((const double *[]){x, u}, &dxdt, NULL, NULL, 0);
}

static double radius(const void *u, const double *x)
{
    double bound, *result = &bound;
    spme_radius((const double *[]){x, u}, &result, NULL, NULL, 0);
    return bound;
}

const char *model_initialise(Model *m)
{
    const Inputs in = inputs(m);
    double *x = m->x;
    spme_initial((const double *[]){in.u}, &x, NULL, NULL, 0);
    m->step_s = 1.0;
    return NULL;
}

const char *model_step(Model *m, double duration)
{
    const Inputs in = inputs(m);
    const Rkc ode = {SPME_N_X, rhs, radius, TOLERANCE};
    double work[RKC_WORK(SPME_N_X)];
    if (rkc_advance(&ode, &in, duration, m->x, &m->step_s, work) != 0) {
        return "the equations have no finite solution over this step";
    }
    /* Concentrations and absolute temperature: positive, or outside what the model describes. */
    for (int k = 0; k < SPME_N_X; ++k) {
        if (!(m->x[k] > 0.0)) {
            return "the cell is outside the model's range: a particle is empty or the electrolyte is depleted";
        }
    }
    return NULL;
}

const char *model_outputs(Model *m)
{
    const Inputs in = inputs(m);
    double out[SPME_N_OUTPUTS], *result = out;
    spme_outputs((const double *[]){m->x, in.u}, &result, NULL, NULL, 0);
    const double voltage = out[0], surface_n = out[3], surface_p = out[4];
    if (!(surface_n > 0.0 && surface_n < 1.0 && surface_p > 0.0 && surface_p < 1.0)) {
        return "the cell is outside the model's range: a particle's surface is full or empty";
    }
    if (!isfinite(voltage)) {
        return "the voltage is not finite";
    }
    m->value[VOLTAGE_V] = voltage;
    m->value[TEMPERATURE_DEGC] = out[1];
    m->value[SOC] = out[2];
    return NULL;
}
