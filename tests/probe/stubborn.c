/* The probe with a life cycle that is not ideal, as the name of its instance says: logging_N and reset_N return status N
 * from fmi2SetDebugLogging and fmi2Reset; ends asks for the end of the simulation in the step that comes to fail_time,
 * and says that it got there; stays says that it did not move in that step.
 */
#include "fmi2Functions.h"
#undef fmi2SetDebugLogging
#undef fmi2Reset
#undef fmi2DoStep
#undef fmi2GetBooleanStatus
#undef fmi2GetRealStatus
#define fmi2SetDebugLogging probe_set_debug_logging
#define fmi2Reset probe_reset
#define fmi2DoStep probe_do_step
#define fmi2GetBooleanStatus probe_get_boolean_status
#define fmi2GetRealStatus probe_get_real_status
#include "probe.c"
#undef fmi2SetDebugLogging
#undef fmi2Reset
#undef fmi2DoStep
#undef fmi2GetBooleanStatus
#undef fmi2GetRealStatus

static int told(const Probe *p, const char *what) {
    return strncmp(p->name, what, strlen(what)) == 0 ? p->name[strlen(what)] - '0' : -1;
}

FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    const int status = told(c, "logging_");
    return status < 0 ? probe_set_debug_logging(c, on, n, categories) : (fmi2Status)status;
}
FMI2_Export fmi2Status fmi2Reset(fmi2Component c) {
    const int status = told(c, "reset_");
    return status < 0 ? probe_reset(c) : (fmi2Status)status;
}
FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set) {
    Probe *p = c;
    const int ends = strncmp(p->name, "ends", 4) == 0, stays = strncmp(p->name, "stays", 5) == 0;
    if ((ends || stays) && t + h >= p->r[FAIL_TIME] - 1e-9) {
        const double after = p->r[FAIL_TIME];
        p->r[FAIL_TIME] = 1e9;
        if (ends) probe_do_step(c, t, h, no_set);
        p->r[FAIL_TIME] = after;
        return fmi2Discard;
    }
    return ends || stays ? (p->i[FAIL_FUNCTION] = 9, probe_do_step(c, t, h, no_set)) : probe_do_step(c, t, h, no_set);
}
FMI2_Export fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind k, fmi2Boolean *v) {
    (void)c;
    *v = 1;
    return k == fmi2Terminated ? fmi2OK : fmi2Discard;
}
FMI2_Export fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind k, fmi2Real *v) {
    *v = ((Probe *)c)->r[CLOCK];
    return k == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}
