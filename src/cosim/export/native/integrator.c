/* RODAS: L-stable, stiffly accurate Rosenbrock method of order 4(3) with six stages and exact Jacobian.

   Hairer, Wanner: Solving Ordinary Differential Equations II, 2nd ed. 1996, section IV.7 and program RODAS.
   With V = I/(h gamma) - J each stage solves
       V k[i] = f(t + alpha[i] h, x + sum_j a[i][j] k[j]) + sum_j c[i][j]/h k[j] + h d[i] df/dt
   The last k is the error estimate, the state at its stage plus it the solution. */
#include "integrator.h"

#include <math.h>
#include <stddef.h>

#if N_CONTINUOUS > 0

enum { STAGES = 6 };

static const double stage_gamma = 0.25;
static const double stage_alpha[STAGES] = {0.0, 0.386, 0.21, 0.63, 1.0, 1.0};
static const double stage_d[STAGES] = {0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0};
static const double stage_a[STAGES][STAGES] = {
    {0.0},
    {1.544},
    {0.9466785280815826, 0.2557011698983284},
    {3.314825187068521, 2.896124015972201, 0.9986419139977817},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0},
};
static const double stage_c[STAGES][STAGES] = {
    {0.0},
    {-5.6688},
    {-2.430093356833875, -0.2063599157091915},
    {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
    {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616},
    {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054},
};

/* Decompose the matrix in place with partial pivoting; 0 if it is singular or not finite. */
static int decompose(double m[N_CONTINUOUS][N_CONTINUOUS], int pivot[N_CONTINUOUS]) {
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
                double swap = m[k][j];
                m[k][j] = m[best][j];
                m[best][j] = swap;
            }
        }
        m[k][k] = 1.0 / m[k][k];
        if (!isfinite(m[k][k])) {
            return 0;
        }
        for (int i = k + 1; i < N_CONTINUOUS; i++) {
            m[i][k] *= m[k][k];
            for (int j = k + 1; j < N_CONTINUOUS; j++) {
                m[i][j] -= m[i][k] * m[k][j];
            }
        }
    }
    return 1;
}

static void solve(double m[N_CONTINUOUS][N_CONTINUOUS], const int pivot[N_CONTINUOUS], double v[N_CONTINUOUS]) {
    for (int k = 0; k < N_CONTINUOUS; k++) {
        double swap = v[pivot[k]];
        v[pivot[k]] = v[k];
        v[k] = swap;
    }
    for (int i = 1; i < N_CONTINUOUS; i++) {
        for (int j = 0; j < i; j++) {
            v[i] -= m[i][j] * v[j];
        }
    }
    for (int i = N_CONTINUOUS - 1; i >= 0; i--) {
        for (int j = i + 1; j < N_CONTINUOUS; j++) {
            v[i] -= m[i][j] * v[j];
        }
        v[i] *= m[i][i];
    }
}

/* One attempt of size h from (t, x) with derivative f, Jacobian and time derivative there: the solution to y.
   Returns the error in units of the tolerance (accept up to 1), NAN if anything is not finite. */
static double attempt(const Problem *problem, Integrator *integrator, double t, double h, const double *x,
                      const double *f, const double *jacobian, const double *time_derivative, double *y) {
    double m[N_CONTINUOUS][N_CONTINUOUS];
    double k[STAGES][N_CONTINUOUS];
    double dx[N_CONTINUOUS];
    int pivot[N_CONTINUOUS];
    for (int i = 0; i < N_CONTINUOUS; i++) {
        for (int j = 0; j < N_CONTINUOUS; j++) {
            m[i][j] = -jacobian[i * N_CONTINUOUS + j];
        }
        m[i][i] += 1.0 / (h * stage_gamma);
    }
    integrator->decompositions++;
    if (!decompose(m, pivot)) {
        return NAN;
    }
    for (int s = 0; s < STAGES; s++) {
        const double *rate = f;
        if (s > 0) {
            for (int i = 0; i < N_CONTINUOUS; i++) {
                y[i] = x[i];
                for (int j = 0; j < s; j++) {
                    y[i] += stage_a[s][j] * k[j][i];
                }
            }
            problem->derivative(t + stage_alpha[s] * h, y, problem->u, problem->p, problem->c, dx);
            integrator->derivatives++;
            rate = dx;
        }
        for (int i = 0; i < N_CONTINUOUS; i++) {
            double sum = 0.0;
            for (int j = 0; j < s; j++) {
                sum += stage_c[s][j] * k[j][i];
            }
            k[s][i] = rate[i] + sum / h + h * stage_d[s] * time_derivative[i];
        }
        solve(m, pivot, k[s]);
    }
    double error = 0.0;
    integrator->failing = -1;
    for (int i = 0; i < N_CONTINUOUS; i++) {
        y[i] += k[STAGES - 1][i];
        double size = fmax(fabs(x[i]), fabs(y[i]));
        double scaled = fabs(k[STAGES - 1][i]) / (problem->tolerance * (size + 0.01 * problem->nominal[i]));
        if (!isfinite(y[i]) || !isfinite(scaled)) {
            integrator->failing = i;
            return NAN;
        }
        if (scaled >= error) {
            error = scaled;
            integrator->failing = i;
        }
    }
    return error;
}

/* Integrate x from t to exactly t_end with constant inputs; 0 or a code of integrator.h. On failure x is the
   state of the last accepted step, integrator->time its time and integrator->failing the state at fault. */
static int integrate(const Problem *problem, Integrator *integrator, double t, double t_end, double *x) {
    double f[N_CONTINUOUS], time_derivative[N_CONTINUOUS], y[N_STATES];
    double jacobian[N_CONTINUOUS * N_CONTINUOUS];
    double step = integrator->step > 0.0 ? integrator->step : t_end - t;
    long attempts = 0;
    int fresh = 0;
    int rejected = 0;
    integrator->failing = -1;
    for (int i = N_CONTINUOUS; i < N_STATES; i++) {
        y[i] = x[i];
    }
    while (t < t_end) {
        double left = t_end - t;
        double h = step;
        /* The last step ends exactly at t_end; the last two share what is left, so that no tiny one remains. */
        int last = h >= 0.999 * left;
        if (last) {
            h = left;
        } else if (h > 0.5 * left) {
            h = 0.5 * left;
        }
        integrator->time = t;
        if (attempts++ >= problem->max_steps) {
            return INTEGRATE_TOO_MANY_STEPS;
        }
        if (!fresh) {
            problem->derivative(t, x, problem->u, problem->p, problem->c, f);
            problem->jacobian(t, x, problem->u, problem->p, problem->c, jacobian, time_derivative);
            integrator->derivatives++;
            integrator->jacobians++;
            fresh = 1;
        }
        double error = attempt(problem, integrator, t, h, x, f, jacobian, time_derivative, y);
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
            fresh = 0;
            double factor = fmin(6.0, 0.9 / sqrt(sqrt(fmax(error, 1e-10))));
            step = rejected ? h * fmin(1.0, factor) : last ? fmax(step, h * factor) : h * factor;
            rejected = 0;
        } else {
            integrator->rejected++;
            rejected = 1;
            step = isnan(error) ? 0.5 * h : h * fmax(0.2, 0.9 / sqrt(sqrt(error)));
            if (!(t + 0.1 * step > t)) {
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
