/* Second-order stabilised explicit Runge-Kutta-Chebyshev method with error control.

   B. P. Sommeijer, L. F. Shampine, J. G. Verwer, "RKC: An explicit solver for parabolic PDEs", J. Comput. Appl. Math.
   88 (1998) 315-326; equation numbers below are that paper's. An s-stage step is stable for real negative eigenvalues
   up to about 0.65 s^2 / step: the cost grows with the square root of the stiffness, and no Jacobian is factorised. */
#include "rkc.h"

#include <math.h>
#include <string.h>

static const double DAMPING = 2.0 / 13.0;
static const int MAX_STEPS = 1000000;   /* guards against a step that shrinks for ever */
static const double MAX_STAGES = 100000; /* guards against a spectral radius that is not finite */

/* One step of s stages from y0, with f0 = f(y0), into y; all arrays of length n, y1, y2 and f are scratch. (2.1)-(2.6) */
static void stages(const Rkc *ode, const void *context, int s, double h, const double *y0, const double *f0, double *y,
                   double *y1, double *y2, double *f)
{
    const int n = ode->n;
    const double w0 = 1.0 + DAMPING / ((double)s * s);
    const double root = sqrt(w0 * w0 - 1.0), arg = s * log(w0 + root);
    const double w1 = sinh(arg) * root * root / (cosh(arg) * s * root - w0 * sinh(arg));
    double b1 = 1.0 / (4.0 * w0 * w0), b2 = b1; /* b of the previous stage and of the one before */
    double T1 = w0, T2 = 1.0, dT1 = 1.0, dT2 = 0.0, d2T1 = 0.0, d2T2 = 0.0; /* Chebyshev polynomials and derivatives at w0 */

    memcpy(y2, y0, (size_t)n * sizeof *y);
    for (int k = 0; k < n; ++k) {
        y1[k] = y0[k] + h * w1 * b1 * f0[k];
    }
    for (int j = 2; j <= s; ++j) {
        const double T = 2.0 * w0 * T1 - T2;
        const double dT = 2.0 * w0 * dT1 - dT2 + 2.0 * T1;
        const double d2T = 2.0 * w0 * d2T1 - d2T2 + 4.0 * dT1;
        const double b = d2T / (dT * dT), a1 = 1.0 - T1 * b1;
        const double mu = 2.0 * w0 * b / b1, nu = -b / b2, mu_f = mu * w1 / w0;

        ode->rhs(context, y1, f);
        for (int k = 0; k < n; ++k) {
            y[k] = mu * y1[k] + nu * y2[k] + (1.0 - mu - nu) * y0[k] + h * mu_f * (f[k] - a1 * f0[k]);
        }
        if (j < s) {
            memcpy(y2, y1, (size_t)n * sizeof *y);
            memcpy(y1, y, (size_t)n * sizeof *y);
            T2 = T1, T1 = T, dT2 = dT1, dT1 = dT, d2T2 = d2T1, d2T1 = d2T, b2 = b1, b1 = b;
        }
    }
}

/* Root mean square of the local error estimate over the tolerance; at most 1 is accepted. (3.2) */
static double scaled_error(const Rkc *ode, double h, const double *y0, const double *f0, const double *y, const double *f)
{
    double sum = 0.0;
    for (int k = 0; k < ode->n; ++k) {
        const double estimate = 0.8 * (y0[k] - y[k]) + 0.4 * h * (f0[k] + f[k]);
        const double scaled = estimate / (ode->tolerance * (1.0 + fmax(fabs(y0[k]), fabs(y[k]))));
        sum += scaled * scaled;
    }
    return sqrt(sum / ode->n);
}

int rkc_advance(const Rkc *ode, const void *context, double duration, double *x, double *step, double *work)
{
    const int n = ode->n;
    double *f0 = work, *y = f0 + n, *f = y + n, *y1 = f + n, *y2 = y1 + n, *scratch = y2 + n;
    double done = 0.0;

    ode->rhs(context, x, f0);
    for (int tries = 0; done < duration; ++tries) {
        const double left = duration - done;
        const int is_last = *step >= left;
        const double h = is_last ? left : fmin(*step, 0.5 * left);
        const double enough = 1.0 + sqrt(1.0 + 1.54 * h * ode->radius(context, x)); /* stages for stability */
        if (tries == MAX_STEPS || !(h > 1e-12 * duration) || !(enough < MAX_STAGES)) {
            return -1;
        }
        stages(ode, context, (int)enough, h, x, f0, y, y1, y2, scratch);
        ode->rhs(context, y, f);
        const double error = scaled_error(ode, h, x, f0, y, f);
        /* An error that is not finite shrinks the step until the caller is told. */
        const double next = h * (isfinite(error) ? fmin(5.0, fmax(0.1, 0.8 * pow(error, -1.0 / 3.0))) : 0.1);
        if (error <= 1.0) {
            memcpy(x, y, (size_t)n * sizeof *x);
            memcpy(f0, f, (size_t)n * sizeof *f);
            done = is_last ? duration : done + h;
        }
        *step = next;
    }
    return 0;
}
