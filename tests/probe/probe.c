/* A scriptable FMI 2.0 co-simulation FMU for tests and benchmarks of the master.
 *
 *   der(y) = (gain*u - y)/time_constant     exact for a held input; no feedthrough
 *   z      = gain*u                         feedthrough
 *   count  = count_in + 1, flag = !flag_in  feedthrough
 *   clock  = end of the last step, calls = number of steps
 *
 * From fail_time on, fmi2DoStep (fail_function 0) or fmi2SetReal (1) or fmi2GetReal (2) returns fail_status
 * with a log message; fail_function 3 fails fmi2ExitInitializationMode, 4 fmi2Instantiate.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#pragma GCC diagnostic ignored "-Wunused-parameter" /* FMI gives most functions more than the probe needs */

enum { U, Y, Z, GAIN, TIME_CONSTANT, Y_START, FAIL_TIME, CLOCK, N_REAL };
enum { COUNT_IN, COUNT, FAIL_STATUS, FAIL_FUNCTION, CALLS, SLEEP, N_INTEGER };
enum { FLAG_IN, FLAG, N_BOOLEAN };

typedef struct {
    fmi2CallbackFunctions callbacks;
    char name[128];
    char label[64];
    int logging;
    double r[N_REAL];
    int i[N_INTEGER];
    int b[N_BOOLEAN];
    double h, decay;
} Probe;

static int live = 0;
/* The number of instances not yet freed, for tests of leaks. */
FMI2_Export int probe_live(void) { return live; }

static const double real_start[N_REAL] = {0.0, 0.0, 0.0, 1.0, 0.1, 0.0, INFINITY, 0.0};

static void start_values(Probe *p) {
    memcpy(p->r, real_start, sizeof real_start);
    memset(p->i, 0, sizeof p->i);
    memset(p->b, 0, sizeof p->b);
    p->i[COUNT] = 1;
    p->i[FAIL_STATUS] = fmi2Error;
    p->b[FLAG] = 1;
    p->h = 0.0;
    strcpy(p->label, "probe");
}

static fmi2Status fail(Probe *p, const char *function) {
    static const char *categories[] = {"logAll",         "logStatusWarning", "logStatusDiscard",
                                       "logStatusError", "logStatusFatal",   "logAll"};
    if (p->logging)
        p->callbacks.logger(p->callbacks.componentEnvironment, p->name, (fmi2Status)p->i[FAIL_STATUS],
                            categories[p->i[FAIL_STATUS]], "%s told to fail at %g s", function, p->r[CLOCK]);
    return (fmi2Status)p->i[FAIL_STATUS];
}

#define FAILS(p, n) ((p)->i[FAIL_FUNCTION] == (n) && (p)->r[CLOCK] >= (p)->r[FAIL_TIME] - 1e-9)

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    if (type != fmi2CoSimulation || strcmp(guid, "probe") != 0) {
        if (logging)
            callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError", "guid %s is not mine",
                              guid);
        return NULL;
    }
    Probe *p = calloc(1, sizeof *p);
    p->callbacks = *callbacks;
    snprintf(p->name, sizeof p->name, "%s", name);
    p->logging = logging;
    start_values(p);
    live++;
    return p;
}
void fmi2FreeInstance(fmi2Component c) {
    live--;
    free(c);
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real tolerance, fmi2Real start, fmi2Boolean e,
                               fmi2Real stop) {
    ((Probe *)c)->r[CLOCK] = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Probe *p = c;
    return p->i[FAIL_FUNCTION] == 3 ? fail(p, "fmi2ExitInitializationMode") : fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) {
    start_values(c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Probe *p = c;
    if (FAILS(p, 2)) return fail(p, "fmi2GetReal");
    p->r[Z] = p->r[GAIN] * p->r[U];
    for (size_t k = 0; k < n; k++) value[k] = p->r[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Probe *p = c;
    if (FAILS(p, 1)) return fail(p, "fmi2SetReal");
    for (size_t k = 0; k < n; k++) {
        p->r[vr[k]] = value[k];
        if (vr[k] == Y_START) p->r[Y] = value[k];
        if (vr[k] == TIME_CONSTANT) p->h = 0.0;
    }
    return fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    Probe *p = c;
    p->i[COUNT] = p->i[COUNT_IN] + 1;
    for (size_t k = 0; k < n; k++) value[k] = p->i[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    for (size_t k = 0; k < n; k++) ((Probe *)c)->i[vr[k]] = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    Probe *p = c;
    p->b[FLAG] = !p->b[FLAG_IN];
    for (size_t k = 0; k < n; k++) value[k] = p->b[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    for (size_t k = 0; k < n; k++) ((Probe *)c)->b[vr[k]] = value[k] != 0;
    return fmi2OK;
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    for (size_t k = 0; k < n; k++) value[k] = ((Probe *)c)->label;
    return fmi2OK;
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    for (size_t k = 0; k < n; k++) snprintf(((Probe *)c)->label, sizeof((Probe *)c)->label, "%s", value[k]);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set) {
    Probe *p = c;
    if (FAILS(p, 0)) {
        fmi2Status status = fail(p, "fmi2DoStep");
        if (status > fmi2Warning) return status;
    }
    for (volatile long spin = 0; spin < 1000L * p->i[SLEEP]; spin++) {
    }
    if (h != p->h) {
        p->h = h;
        p->decay = exp(-h / p->r[TIME_CONSTANT]);
    }
    double end = p->r[GAIN] * p->r[U];
    p->r[Y] = end + (p->r[Y] - end) * p->decay;
    p->r[CLOCK] = t + h;
    p->i[CALLS]++;
    return FAILS(p, 0) && p->i[FAIL_STATUS] == fmi2Warning ? fmi2Warning : fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    ((Probe *)c)->logging = on;
    return fmi2OK;
}

/* Not offered by this FMU. */
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { return fmi2Error; }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { return fmi2Error; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { return fmi2Error; }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) { return fmi2Error; }
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) { return fmi2Error; }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) { return fmi2Error; }
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference a[], size_t na,
                                        const fmi2ValueReference b[], size_t nb, const fmi2Real dv[], fmi2Real dz[]) {
    return fmi2Error;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real v[]) {
    return fmi2Error;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real v[]) {
    return fmi2Error;
}
fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2Error; }
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *s) { return fmi2Discard; }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) { return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v) { return fmi2Discard; }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) { return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v) { return fmi2Discard; }
