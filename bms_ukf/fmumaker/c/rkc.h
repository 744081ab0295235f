#ifndef RKC_H
#define RKC_H

/* dx/dt of an autonomous system of n equations, with whatever `context` holds fixed. */
typedef void rkc_rhs(const void *context, const double *x, double *dxdt);

/* A bound on the spectral radius of the Jacobian of the right-hand side, 1/s. */
typedef double rkc_radius(const void *context, const double *x);

typedef struct {
    int n;
    rkc_rhs *rhs;
    rkc_radius *radius;
    double tolerance; /* of one step, absolute and relative: the states are expected to be of order 1 */
} Rkc;

/* Length of scratch memory needed, in doubles. */
#define RKC_WORK(n) (6 * (n))

/* Advances x (modified in place) by exactly `duration` > 0 seconds. `step` is the step to try first, and the one to try
   next time (modified; any positive start value will do). Returns 0, or -1 if x stopped being finite or the step would
   have to be too small: x is then not usable. */
int rkc_advance(const Rkc *ode, const void *context, double duration, double *x, double *step, double *work);

#endif
