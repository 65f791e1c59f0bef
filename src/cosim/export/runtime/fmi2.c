/* FMI 2.0 co-simulation, and model exchange for plants; included by the generated model.c. */
#include "contract.h"
#include "fmi2.h"

/* The importer's memory functions are never used: some hosts have broken ones. */
typedef struct {
    fmi2ComponentEnvironment environment;
    fmi2CallbackLogger logger;
} Host;
#define UNFINISHED DISCARD
static const char *const type_names[] = {"Real", "Integer", "Boolean", "String"};

#include "core.c"

static void deliver(const Instance *instance, int status, const char *category, char *text) {
    if (!instance->host.logger) return;
    for (char *p = text; *p; p++)
        if (*p == '%') *p = '#'; /* some importers take the message as a format, others print it as it is */
    instance->host.logger(instance->host.environment, instance->name, (fmi2Status)status, category, text);
}

#ifdef __cplusplus
extern "C" {
#endif

/* ---- life cycle ---- */

FMI2_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI2_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    static const char function[] = "fmi2Instantiate";
    Instance probe; /* delivers the reason of a refused instance, even if logging is off */
    (void)resources;
    (void)visible;
    if (!callbacks) return NULL;
    memset(&probe, 0, sizeof probe);
    probe.host.environment = callbacks->componentEnvironment;
    probe.host.logger = callbacks->logger;
    probe.categories = EVERY_CATEGORY;
    probe.name = (char *)(name ? name : "");
    if (!acceptable(&probe, name, guid, function)) return NULL;
    if (type != fmi2CoSimulation && !(KIND == PLANT && type == fmi2ModelExchange)) {
        say(&probe, ERROR, SAY_CO_SIMULATION_ONLY, function);
        return NULL;
    }
    return make_instance(&probe, name, probe.host, type == fmi2ModelExchange, logging, function);
}

FMI2_EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    static const char function[] = "fmi2SetDebugLogging";
    Instance *instance = c;
    unsigned categories;
    if (illegal(instance, MAY_SET_LOGGING, function) || missing(instance, names, n, function)) return fmi2Error;
    categories = n ? named_categories(instance, n, names, function) : EVERY_CATEGORY;
    if (!categories) return fmi2Error;
    instance->categories = on ? categories : ONLY_ERRORS;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    static const char function[] = "fmi2SetupExperiment";
    Instance *instance = c;
    if (illegal(instance, MAY_SET_UP, function)) return fmi2Error;
    return set_up(instance, tolerance_defined, tolerance, start, stop_defined, stop, function);
}

FMI2_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_INITIALIZATION, "fmi2EnterInitializationMode")) return fmi2Error;
    enter_initialization(instance);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    static const char function[] = "fmi2ExitInitializationMode";
    Instance *instance = c;
    if (illegal(instance, MAY_EXIT_INITIALIZATION, function)) return fmi2Error;
    return leave_initialization(instance, instance->model_exchange ? EVENT_MODE : STEP_COMPLETE, function);
}

FMI2_EXPORT fmi2Status fmi2Terminate(fmi2Component c) { return terminate(c, "fmi2Terminate"); }

FMI2_EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, MAY_RESET, "fmi2Reset")) return fmi2Error;
    set_start_values(&instance->s);
    return fmi2OK;
}

/* ---- values ---- */

FMI2_EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                   fmi2Real values[]) {
    Instance *instance = c;
#if PLAIN_OUTPUTS /* a faster path for the call of every step: one pass */
    if (instance && references && values && instance->s.phase & EVALUATED) {
        size_t i = 0;
        refresh(&instance->s, 0);
        while (i < n && references[i] - STATE_0 < N_STATES + N_OUTPUTS) {
            values[i] = instance->s.v[references[i]];
            i++;
        }
        if (i == n && instance->s.finite) return fmi2OK;
    }
#endif
    if (prepare_get(instance, references, n, values, REAL, "fmi2GetReal")) return fmi2Error;
    for (size_t i = 0; i < n; i++) values[i] = instance->s.v[references[i]];
    for (size_t i = 0; i < n; i++)
        if (!isfinite(values[i])) return discard_result(instance, references[i], "fmi2GetReal");
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      fmi2Integer values[]) {
    Instance *instance = c;
    if (prepare_get(instance, references, n, values, INTEGER, "fmi2GetInteger")) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        if (variables[references[i]].role == COUNTER) {
            const unsigned long long count = counter(&instance->s, references[i] - COUNTER_0);
            values[i] = count > 2147483647u ? 2147483647 : (fmi2Integer)count;
        } else
            values[i] = (fmi2Integer)instance->s.v[references[i]];
    }
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      fmi2Boolean values[]) {
    Instance *instance = c;
    if (prepare_get(instance, references, n, values, BOOLEAN, "fmi2GetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n; i++) values[i] = instance->s.v[references[i]] != 0.0;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                     fmi2String values[]) {
    return prepare_get(c, references, n, values, STRING, "fmi2GetString") ? fmi2Error : fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                   const fmi2Real values[]) {
    Instance *instance = c;
    int status = OK;
    size_t i = 0;
#if PLAIN_INPUTS /* a faster path for the call of every step: one pass */
    if (instance && references && values && instance->s.phase & MAY_SET) {
        while (i < n && references[i] - INPUT_0 < N_INPUTS && fabs(values[i]) <= DBL_MAX) {
            instance->s.v[references[i]] = values[i];
            i++;
        }
        touch(&instance->s);
        if (i == n) return fmi2OK;
    }
#endif
    if (prepare_set(instance, references, n, values, REAL, "fmi2SetReal")) return fmi2Error;
    for (; i < n && status != ERROR; i++)
        status = worse(status, set(instance, references[i], values[i], "fmi2SetReal"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      const fmi2Integer values[]) {
    Instance *instance = c;
    int status = OK;
    if (prepare_set(instance, references, n, values, INTEGER, "fmi2SetInteger")) return fmi2Error;
    for (size_t i = 0; i < n && status != ERROR; i++)
        status = worse(status, set(instance, references[i], values[i], "fmi2SetInteger"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      const fmi2Boolean values[]) {
    Instance *instance = c;
    int status = OK;
    if (prepare_set(instance, references, n, values, BOOLEAN, "fmi2SetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n && status != ERROR; i++)
        status = worse(status, set(instance, references[i], values[i] != 0, "fmi2SetBoolean"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                     const fmi2String values[]) {
    return prepare_set(c, references, n, values, STRING, "fmi2SetString") ? fmi2Error : fmi2OK;
}

/* Calls on variables that these FMUs do not have: only n == 0 is allowed. */
enum { INPUT_DERIVATIVES, OUTPUT_DERIVATIVES };
static fmi2Status not_offered(Instance *instance, int phases, size_t n, int what, const char *function) {
    if (illegal(instance, phases, function)) return fmi2Error;
    if (n == 0) return fmi2OK;
    if (what == INPUT_DERIVATIVES)
        say(instance, ERROR, SAY_NO_INPUT_DERIVATIVES, function);
    else
        say(instance, ERROR, SAY_NO_OUTPUT_DERIVATIVES, function);
    return fail(instance);
}

FMI2_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                   const fmi2Integer orders[], const fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    return not_offered(c, MAY_SET, n, INPUT_DERIVATIVES, "fmi2SetRealInputDerivatives");
}

FMI2_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                    const fmi2Integer orders[], fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    return not_offered(c, MAY_GET, n, OUTPUT_DERIVATIVES, "fmi2GetRealOutputDerivatives");
}

/* ---- FMU state ---- */

FMI2_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    return save_state(c, saved, "fmi2GetFMUstate");
}

FMI2_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) {
    return restore_state(c, saved, "fmi2SetFMUstate");
}

FMI2_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    return free_state(c, saved, "fmi2FreeFMUstate");
}

FMI2_EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size) {
    return state_size(c, saved, size, "fmi2SerializedFMUstateSize");
}

FMI2_EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size) {
    return serialize_state(c, saved, bytes, size, "fmi2SerializeFMUstate");
}

FMI2_EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *saved) {
    return deserialize_state(c, bytes, size, saved, "fmi2DeSerializeFMUstate");
}

/* ---- derivatives ---- */

FMI2_EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[],
                                                    size_t n_unknown, const fmi2ValueReference knowns[], size_t n_known,
                                                    const fmi2Real seed[], fmi2Real result[]) {
    return directional_derivative(c, unknowns, n_unknown, knowns, n_known, seed, result,
                                  "fmi2GetDirectionalDerivative");
}

/* ---- model exchange ---- */

FMI2_EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_EVENT_MODE, "fmi2EnterEventMode")) return fmi2Error;
    instance->s.phase = EVENT_MODE;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    return enter_continuous_time(c, "fmi2EnterContinuousTimeMode");
}

/* There are no events: inputs may jump at any event mode. */
FMI2_EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Instance *instance = c;
    if (illegal(instance, MAY_UPDATE_DISCRETE_STATES, "fmi2NewDiscreteStates") ||
        missing(instance, info, 1, "fmi2NewDiscreteStates"))
        return fmi2Error;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_rollback,
                                                   fmi2Boolean *enter_event_mode, fmi2Boolean *terminate) {
    static const char function[] = "fmi2CompletedIntegratorStep";
    (void)no_rollback;
    if (illegal(c, MAY_COMPLETE_STEP, function) || missing(c, enter_event_mode, 1, function) ||
        missing(c, terminate, 1, function))
        return fmi2Error;
    *enter_event_mode = *terminate = fmi2False;
    return completed_step(c);
}

FMI2_EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return set_time(c, time, "fmi2SetTime"); }

FMI2_EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    return set_continuous_states(c, x, n, "fmi2SetContinuousStates");
}

FMI2_EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    return continuous_states(c, x, n, "fmi2GetContinuousStates");
}

FMI2_EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) {
    return state_derivatives(c, derivatives, n, "fmi2GetDerivatives");
}

FMI2_EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    return event_indicators(c, indicators, n, "fmi2GetEventIndicators");
}

FMI2_EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real values[], size_t n) {
    return state_nominals(c, values, n, "fmi2GetNominalsOfContinuousStates");
}

/* ---- stepping ---- */

FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
    static const char function[] = "fmi2DoStep";
    (void)no_rollback;
    return steppable(c, time, step, function) ? step_to(c, time, step, function) : ERROR;
}

FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, MAY_CALL, "fmi2CancelStep")) return fmi2Error;
    say(instance, ERROR, SAY_NO_STEP_IN_PROGRESS, "fmi2CancelStep");
    return fail(instance);
}

/* For this type of value only the status kind ``known`` exists: a call for another kind is discarded. */
static fmi2Status only(Instance *instance, fmi2StatusKind kind, fmi2StatusKind known, const void *value,
                       const char *function, const char *name) {
    if (illegal(instance, MAY_ASK_STATUS, function) || missing(instance, value, 1, function)) return fmi2Error;
    if (kind == known) return fmi2OK;
    say(instance, DISCARD, SAY_ONLY_STATUS, function, name);
    return fmi2Discard;
}

FMI2_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *instance = c;
    const fmi2Status status =
        only(c, kind, fmi2LastSuccessfulTime, value, "fmi2GetRealStatus", "fmi2LastSuccessfulTime");
    if (status == fmi2OK) *value = instance->s.time;
    return status;
}

FMI2_EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    const fmi2Status status = only(c, kind, fmi2Terminated, value, "fmi2GetBooleanStatus", "fmi2Terminated");
    if (status == fmi2OK) *value = fmi2False; /* the component never asks to end the simulation */
    return status;
}

static fmi2Status no_status(Instance *instance, const char *function) {
    if (illegal(instance, MAY_ASK_STATUS, function)) return fmi2Error;
    say(instance, DISCARD, SAY_NEVER_PENDING, function);
    return fmi2Discard;
}

FMI2_EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind;
    (void)value;
    return no_status(c, "fmi2GetStatus");
}

FMI2_EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind;
    (void)value;
    return no_status(c, "fmi2GetIntegerStatus");
}

FMI2_EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind;
    (void)value;
    return no_status(c, "fmi2GetStringStatus");
}

#ifdef __cplusplus
}
#endif
