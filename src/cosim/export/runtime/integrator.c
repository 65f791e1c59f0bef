/* One-step method of order 5 with exact Jacobian, L-stable, three evaluations of the derivative a step.

   As in exponential Rosenbrock methods (Hochbruck, Ostermann, Schweitzer, SIAM J. Numer. Anal. 47, 2009) the equations
   linearized at the start of the step are solved directly; only the remainders of the derivative,
       D(V) = h f(x + V) - h f(x) - h J V,
   are evaluated, at a node and at the end of the step. Polynomials in W = (I - gamma h J)^-1 stand for the exponential
   functions, so a step costs one small inverse and its products with vectors. Such a method is a Rosenbrock method
   (Hairer, Wanner, Solving Ordinary Differential Equations II, 1996, section IV.7) whose stages share evaluations. Time
   counts as a state: h J V includes h df/dt dt. The coefficients follow from conditions of order 5, stiff accuracy and
   damping (|R(z) - exp(z)| < 0.004 for z < 0), stated and solved in tests/integrator_coefficients.py. */
#include "integrator.h"

#include <math.h>
#include <stddef.h>

#if N_CONTINUOUS > 0

/* Replace the matrix by its inverse (Gauss-Jordan, partial pivoting); 0 if it is singular or not finite. */
static int invert(double m[N_CONTINUOUS][N_CONTINUOUS]) {
    int pivot[N_CONTINUOUS];
    for (int k = 0; k < N_CONTINUOUS; k++) {
        int best = k;
        for (int i = k + 1; i < N_CONTINUOUS; i++) {
            if (fabs(m[i][k]) > fabs(m[best][k])) {
                best = i;
            }
        }
        pivot[k] = best;
        if (best != k) {
            for (int j = 0; j < N_CONTINUOUS; j++) {
                const double swap = m[k][j];
                m[k][j] = m[best][j];
                m[best][j] = swap;
            }
        }
        const double reciprocal = 1.0 / m[k][k];
        if (!isfinite(reciprocal) || reciprocal == 0.0) {
            return 0;
        }
        m[k][k] = 1.0;
        for (int j = 0; j < N_CONTINUOUS; j++) {
            m[k][j] *= reciprocal;
        }
        for (int i = 0; i < N_CONTINUOUS; i++) {
            if (i != k) {
                const double factor = m[i][k];
                m[i][k] = 0.0;
                for (int j = 0; j < N_CONTINUOUS; j++) {
                    m[i][j] -= factor * m[k][j];
                }
            }
        }
    }
    for (int k = N_CONTINUOUS - 1; k >= 0; k--) {
        if (pivot[k] != k) {
            for (int i = 0; i < N_CONTINUOUS; i++) {
                const double swap = m[i][k];
                m[i][k] = m[i][pivot[k]];
                m[i][pivot[k]] = swap;
            }
        }
    }
    return 1;
}

static void multiply(double m[N_CONTINUOUS][N_CONTINUOUS], const double *v, double *result) {
    for (int i = 0; i < N_CONTINUOUS; i++) {
        double sum = m[i][0] * v[0];
        for (int j = 1; j < N_CONTINUOUS; j++) {
            sum += m[i][j] * v[j];
        }
        result[i] = sum;
    }
}

/* Index of the first value that is not finite, else -1. */
static int first_not_finite(const double *values, int count) {
    for (int i = 0; i < count; i++) {
        if (!isfinite(values[i])) {
            return i;
        }
    }
    return -1;
}

/* One attempt of size h from (t, x), given derivative f, Jacobian and time derivative at (t, x); y gets the solution.
   Returns the error in units of the tolerance (accept up to 1), NAN if anything is not finite. */
static double attempt(const Problem *problem, Integrator *integrator, double t, double h, const double *x,
                      const double *f, const double *jacobian, const double *time_derivative, double *y) {
    /* Weights of W, W^2, ...: of h f in the state at the node and at the end, of the remainder at the node in the last
       stage, and of the remainders at the node and at the end in the solution. */
    enum { POWERS = 8, REMAINDER_POWERS = 5, STAGE_POWERS = 3 };
    static const double gamma = 0.14, node = 0.6;
    static const double to_node[POWERS] = {
        0.14, 0.133, 0.31, -1.174, 4.361947521865889, -5.725822157434402, 3.2480874635568515, -0.6932128279883382};
    static const double to_end[POWERS] = {0.14,
                                          0.14,
                                          0.126,
                                          0.6804262113008469,
                                          -2.839139247535749,
                                          6.066833263917812,
                                          -4.359382201860336,
                                          1.045261974177426};
    static const double node_in_stage[STAGE_POWERS] = {0.3888888888888889, -0.1, 1.1925925925925926};
    static const double from_node[REMAINDER_POWERS] = {0.0, 0.1361111111111111, 0.06407785336356765, 0.7035903250188964,
                                                       -0.3250755857898715};
    static const double from_end[REMAINDER_POWERS] = {0.14, 0.0518, 0.04201496598639456, -0.1744299319727891,
                                                      0.06561496598639456};
    /* Error estimate: the fourth difference of the powers of the linear part, scaled to bound |R(z) - exp(z)| on the
       negative axis, and the departure of the remainders from quadratic growth, scaled by measured error. */
    static const double linear_error = 0.625, remainder_error = 1.0 / 32.0;

    double w[N_CONTINUOUS][N_CONTINUOUS];               /* W */
    double linear[POWERS + 1][N_CONTINUOUS];            /* W^k h f */
    double at_node[REMAINDER_POWERS + 1][N_CONTINUOUS]; /* W^k D(node) */
    double at_end[REMAINDER_POWERS + 1][N_CONTINUOUS];  /* W^k D(end) */
    double solution[N_CONTINUOUS];                      /* part due to h f */
    double rate[N_CONTINUOUS];

    for (int i = 0; i < N_CONTINUOUS; i++) {
        for (int j = 0; j < N_CONTINUOUS; j++) {
            w[i][j] = -gamma * h * jacobian[i * N_CONTINUOUS + j];
        }
        w[i][i] += 1.0;
    }
    integrator->decompositions++;
    integrator->failing = -1;
    if (!invert(w)) {
        return NAN;
    }

    for (int i = 0; i < N_CONTINUOUS; i++) {
        linear[0][i] = h * f[i];
    }
    for (int k = 0; k < POWERS; k++) {
        double v[N_CONTINUOUS];
        for (int i = 0; i < N_CONTINUOUS; i++) {
            v[i] = linear[k][i] + gamma * h * h * time_derivative[i];
        }
        multiply(w, v, linear[k + 1]);
    }

    /* h J W^k v = (W^k v - W^(k-1) v)/gamma gives h J V without a product; h f(x) cancels as to_node[0] = gamma. */
    for (int i = 0; i < N_CONTINUOUS; i++) {
        double v = to_node[0] * linear[1][i], shifted = to_node[1] * linear[1][i];
        for (int k = 1; k < POWERS; k++) {
            v += to_node[k] * linear[k + 1][i];
        }
        for (int k = 2; k < POWERS; k++) {
            shifted += to_node[k] * linear[k][i];
        }
        y[i] = x[i] + v;
        at_node[0][i] = (shifted - v) * (1.0 / gamma);
    }
    problem->derivative(t + node * h, y, problem->u, problem->p, problem->c, rate);
    integrator->derivatives++;
    integrator->failing = first_not_finite(rate, N_CONTINUOUS);
    if (integrator->failing >= 0) {
        return NAN;
    }
    for (int i = 0; i < N_CONTINUOUS; i++) {
        at_node[0][i] += h * rate[i];
    }
    for (int k = 0; k < REMAINDER_POWERS; k++) {
        multiply(w, at_node[k], at_node[k + 1]);
    }

    for (int i = 0; i < N_CONTINUOUS; i++) {
        double v = to_end[0] * linear[1][i], shifted = to_end[1] * linear[1][i];
        for (int k = 1; k < POWERS; k++) {
            v += to_end[k] * linear[k + 1][i];
        }
        for (int k = 2; k < POWERS; k++) {
            shifted += to_end[k] * linear[k][i];
        }
        solution[i] = v;
        for (int k = 0; k < STAGE_POWERS; k++) {
            v += node_in_stage[k] * at_node[k + 1][i];
            shifted += node_in_stage[k] * at_node[k][i];
        }
        y[i] = x[i] + v;
        at_end[0][i] = (shifted - v) * (1.0 / gamma);
    }
    problem->derivative(t + h, y, problem->u, problem->p, problem->c, rate);
    integrator->derivatives++;
    integrator->failing = first_not_finite(rate, N_CONTINUOUS);
    if (integrator->failing >= 0) {
        return NAN;
    }
    for (int i = 0; i < N_CONTINUOUS; i++) {
        at_end[0][i] += h * rate[i];
    }
    for (int k = 0; k < REMAINDER_POWERS; k++) {
        multiply(w, at_end[k], at_end[k + 1]);
    }

    double largest = 0.0;
    for (int i = 0; i < N_CONTINUOUS; i++) {
        double v = solution[i];
        for (int k = 0; k < REMAINDER_POWERS; k++) {
            v += from_node[k] * at_node[k + 1][i] + from_end[k] * at_end[k + 1][i];
        }
        y[i] = x[i] + v;
        const double fourth =
            linear[4][i] - 4.0 * linear[5][i] + 6.0 * linear[6][i] - 4.0 * linear[7][i] + linear[8][i];
        const double departure = at_end[2][i] - at_node[2][i] * (1.0 / (node * node));
        const double error = (linear_error * fabs(fourth) + remainder_error * fabs(departure)) /
                             (problem->tolerance * (fmax(fabs(x[i]), fabs(y[i])) + problem->nominal[i]));
        if (!isfinite(y[i]) || !isfinite(error)) {
            integrator->failing = i;
            return NAN;
        }
        if (error > largest) {
            largest = error;
            integrator->failing = i;
        }
    }
    return largest;
}

static int integrate(const Problem *problem, Integrator *integrator, double t, double t_end, double *x) {
    double f[N_CONTINUOUS], time_derivative[N_CONTINUOUS], y[N_STATES];
    double jacobian[N_CONTINUOUS * N_CONTINUOUS];
    double step = integrator->step > 0.0 ? integrator->step : t_end - t;
    /* Below this step size the rounding of the time, some 1e-16 of its value, would be a large part of the step. */
    const double smallest = 1e-15 * fmax(fabs(t), fabs(t_end));
    long attempts = 0;
    int known = 0; /* f, jacobian and time_derivative belong to (t, x) */
    int rejected = 0;
    integrator->failing = -1;
    for (int i = N_CONTINUOUS; i < N_STATES; i++) {
        y[i] = x[i];
    }
    while (t < t_end) {
        /* The last step ends exactly at t_end. The last two steps share the rest, so that no tiny step remains. */
        const double left = t_end - t;
        const int last = step >= 0.999 * left;
        const double h = last ? left : fmin(step, 0.5 * left);
        integrator->time = t;
        if (attempts++ >= problem->max_steps) {
            integrator->step = 0.0;
            return INTEGRATE_TOO_MANY_STEPS;
        }
        if (!known) {
            problem->derivative(t, x, problem->u, problem->p, problem->c, f);
            problem->jacobian(t, x, problem->u, problem->p, problem->c, jacobian, time_derivative);
            integrator->derivatives++;
            integrator->jacobians++;
            known = 1;
            int bad = first_not_finite(f, N_CONTINUOUS);
            if (bad < 0) {
                bad = first_not_finite(time_derivative, N_CONTINUOUS);
            }
            if (bad < 0) {
                bad = first_not_finite(jacobian, N_CONTINUOUS * N_CONTINUOUS);
                bad = bad < 0 ? bad : bad / N_CONTINUOUS;
            }
            if (bad >= 0) {
                integrator->failing = bad;
                integrator->step = 0.0;
                return INTEGRATE_NOT_FINITE;
            }
        }
        const double error = attempt(problem, integrator, t, h, x, f, jacobian, time_derivative, y);
        if (error <= 1.0) {
            integrator->steps++;
            t = last ? t_end : t + h;
            for (int i = 0; i < N_CONTINUOUS; i++) {
                x[i] = y[i];
            }
            if (problem->accepted != NULL) {
                problem->accepted(t, x, problem->u, problem->p, problem->c);
                for (int i = N_CONTINUOUS; i < N_STATES; i++) {
                    y[i] = x[i];
                }
            }
            known = 0;
            /* A step shortened by t_end is no reason to make the proposed step smaller. */
            const double next = h * fmin(rejected ? 1.0 : 6.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
            step = last && !rejected ? fmax(step, next) : next;
            rejected = 0;
        } else {
            integrator->rejected++;
            rejected = 1;
            step = isnan(error) ? 0.5 * h : h * fmax(0.2, 0.9 / sqrt(sqrt(error)));
            if (step < smallest) {
                integrator->step = 0.0;
                return isnan(error) ? INTEGRATE_NOT_FINITE : INTEGRATE_STEP_TOO_SMALL;
            }
        }
    }
    integrator->step = step;
    integrator->time = t_end;
    return INTEGRATE_OK;
}

#else

/* Without continuous states the whole communication step is one accepted step. */
static int integrate(const Problem *problem, Integrator *integrator, double t, double t_end, double *x) {
    (void)t;
    integrator->failing = -1;
    integrator->time = t_end;
    integrator->steps++;
    if (problem->accepted != NULL) {
        problem->accepted(t_end, x, problem->u, problem->p, problem->c);
    }
    return INTEGRATE_OK;
}

#endif
