/* Adaptive integration of stiff ordinary differential equations over one communication step.

   Plain data only: no globals, no allocation, no library but math.h. The including file defines
   N_CONTINUOUS (continuous states, 0 allowed) and, if there are others, N_STATES (all states). */
#ifndef INTEGRATOR_H
#define INTEGRATOR_H

#ifndef N_STATES
#define N_STATES N_CONTINUOUS
#endif

/* x: all N_STATES states, the continuous ones first; u inputs, p parameters, c constants derived from p. */
/* Writes the N_CONTINUOUS derivatives dx. */
typedef void (*derivative_function)(double t, const double *x, const double *u, const double *p, const double *c,
                                    double *dx);
/* Writes d dx[i] / d x[j] to jacobian[i*N_CONTINUOUS + j] and d dx[i] / dt to time_derivative[i]. */
typedef void (*jacobian_function)(double t, const double *x, const double *u, const double *p, const double *c,
                                  double *jacobian, double *time_derivative);
/* Called after each accepted step, may change x[N_CONTINUOUS] ... x[N_STATES - 1]. */
typedef void (*accepted_function)(double t, double *x, const double *u, const double *p, const double *c);

typedef struct {
    derivative_function derivative;
    jacobian_function jacobian;
    accepted_function accepted; /* may be NULL */
    const double *u;
    const double *p;
    const double *c;
    const double *nominal; /* order of magnitude of each continuous state, > 0 */
    double tolerance;      /* relative */
    long max_steps;        /* attempts in one call of integrate */
} Problem;

/* Part of the state of an instance: copied by value. All zero before the first call. */
typedef struct {
    double step; /* proposal for the next step, s; 0: none yet */
    double time; /* after a failure: time of the last accepted step, s */
    int failing; /* after a failure: the continuous state with the largest error, or not finite; else -1 */
    unsigned long long steps;
    unsigned long long rejected;
    unsigned long long derivatives;
    unsigned long long jacobians;
    unsigned long long decompositions;
} Integrator;

enum {
    INTEGRATE_OK = 0,
    INTEGRATE_STEP_TOO_SMALL = 1, /* error test failed down to the resolution of time */
    INTEGRATE_TOO_MANY_STEPS = 2, /* max_steps attempts did not reach t_end */
    INTEGRATE_NOT_FINITE = 3      /* derivative or Jacobian not finite down to the resolution of time */
};

#endif
