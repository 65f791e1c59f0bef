/* Problems with known solutions for the integrator; compiled with N_CONTINUOUS given and one discrete state more. */
#define N_STATES (N_CONTINUOUS + 1)
#include "integrator.c"

#define SIZE (N_CONTINUOUS > 0 ? N_CONTINUOUS : 1)

/* x' = A x, A row by row in p. */
static void linear(double t, const double *x, const double *u, const double *p, const double *c, double *dx) {
    (void)t, (void)u, (void)c;
    for (int i = 0; i < N_CONTINUOUS; i++) {
        dx[i] = 0.0;
        for (int j = 0; j < N_CONTINUOUS; j++) dx[i] += p[i * N_CONTINUOUS + j] * x[j];
    }
}

static void linear_jacobian(double t, const double *x, const double *u, const double *p, const double *c,
                            double *jacobian, double *time_derivative) {
    (void)t, (void)x, (void)u, (void)c;
    for (int i = 0; i < N_CONTINUOUS * N_CONTINUOUS; i++) jacobian[i] = p[i];
    for (int i = 0; i < N_CONTINUOUS; i++) time_derivative[i] = 0.0;
}

/* Discrete state: number of steps accepted. */
static void count(double t, double *x, const double *u, const double *p, const double *c) {
    (void)t, (void)u, (void)p, (void)c;
    x[N_CONTINUOUS] += 1.0;
}

#if N_CONTINUOUS == 3

/* Kaps: x0 = exp(-2t), x1 = exp(-t) whatever mu = p[0]; x2 = sin(t) if x2(0) = 0, driven by time. */
static void kaps(double t, const double *x, const double *u, const double *p, const double *c, double *dx) {
    (void)u, (void)c;
    dx[0] = -(p[0] + 2.0) * x[0] + p[0] * x[1] * x[1];
    dx[1] = x[0] - x[1] - x[1] * x[1];
    dx[2] = x[2] * x[2] + x[0] * (sin(t) - x[2]) + cos(t) - sin(t) * sin(t);
}

static void kaps_jacobian(double t, const double *x, const double *u, const double *p, const double *c,
                          double *jacobian, double *time_derivative) {
    const double rows[9] = {-(p[0] + 2.0), 2.0 * p[0] * x[1], 0.0, 1.0, -1.0 - 2.0 * x[1], 0.0, sin(t) - x[2],
                            0.0,           2.0 * x[2] - x[0]};
    (void)u, (void)c;
    for (int i = 0; i < 9; i++) jacobian[i] = rows[i];
    time_derivative[0] = time_derivative[1] = 0.0;
    time_derivative[2] = x[0] * cos(t) - sin(t) - 2.0 * sin(t) * cos(t);
}

/* x1' = x1^2: infinite at t = 1/x1(0). */
static void blow_up(double t, const double *x, const double *u, const double *p, const double *c, double *dx) {
    (void)t, (void)u, (void)p, (void)c;
    dx[0] = dx[2] = 0.0;
    dx[1] = x[1] * x[1];
}

static void blow_up_jacobian(double t, const double *x, const double *u, const double *p, const double *c,
                             double *jacobian, double *time_derivative) {
    (void)t, (void)u, (void)p, (void)c;
    for (int i = 0; i < 9; i++) jacobian[i] = 0.0;
    for (int i = 0; i < 3; i++) time_derivative[i] = 0.0;
    jacobian[4] = 2.0 * x[1];
}

/* x2' = 1 + sqrt(1 - x2): from 0 it reaches 1, the end of its domain, at t = 2 - 2 log(2). */
static void domain(double t, const double *x, const double *u, const double *p, const double *c, double *dx) {
    (void)t, (void)u, (void)p, (void)c;
    dx[0] = dx[1] = 0.0;
    dx[2] = 1.0 + sqrt(1.0 - x[2]);
}

static void domain_jacobian(double t, const double *x, const double *u, const double *p, const double *c,
                            double *jacobian, double *time_derivative) {
    (void)t, (void)u, (void)p, (void)c;
    for (int i = 0; i < 9; i++) jacobian[i] = 0.0;
    for (int i = 0; i < 3; i++) time_derivative[i] = 0.0;
    jacobian[8] = -0.5 / sqrt(1.0 - x[2]);
}

#endif

__attribute__((visibility("default"))) int run(int problem, double tolerance, long max_steps, const double *p,
                                               Integrator *integrator, double t, double t_end, double *x) {
    double nominal[SIZE];
    Problem known = {linear, linear_jacobian, count, NULL, p, NULL, nominal, tolerance, max_steps};
    for (int i = 0; i < SIZE; i++) nominal[i] = 1.0;
#if N_CONTINUOUS == 3
    if (problem == 1) known.derivative = kaps, known.jacobian = kaps_jacobian;
    if (problem == 2) known.derivative = blow_up, known.jacobian = blow_up_jacobian;
    if (problem == 3) known.derivative = domain, known.jacobian = domain_jacobian;
#else
    (void)problem;
#endif
    return integrate(&known, integrator, t, t_end, x);
}
