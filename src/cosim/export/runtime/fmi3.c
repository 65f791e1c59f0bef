/* FMI 3.0 co-simulation, and model exchange for plants; included by the generated model.c.

   Arrays: lengths[reference], in model.c, is the number of elements of the variable with that value reference. It is 0
   for the further elements of an array. The last value reference is that of time.
   Event mode: the sampling instants of a controller are its events. An importer that uses event mode gets the outputs
   for the inputs of a sampling instant without delay: it sets inputs and reads outputs before fmi3EnterStepMode. */
#include "contract.h"
#include "fmi3.h"

typedef struct {
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    int event_mode_used;
    int early_return_allowed;
} Host;
#define UNFINISHED ERROR /* fmi3Discard would promise that nothing has changed */
#define ELEMENTS(reference) lengths[reference]

enum { INT8 = UNSIGNED + 1, UINT8, INT16, UINT16, UINT32, FLOAT32, BINARY, CLOCK };
static const char *const type_names[] = {"Float64", "Int32", "Boolean", "String", "Int64",   "UInt64", "Int8",
                                         "UInt8",   "Int16", "UInt16",  "UInt32", "Float32", "Binary", "Clock"};

#include "core.c"

static void deliver(const Instance *instance, int status, const char *category, char *text) {
    char escaped[2048];
    char *to = escaped;
    if (!instance->host.log) return;
    for (const char *from = text; *from; *to++ = *from++)
        if (*from == '#') *to++ = '#'; /* FMI 3.0: a single # would begin a value reference */
    *to = '\0';
    instance->host.log(instance->host.environment, (fmi3Status)status, category, escaped);
}

#ifdef __cplusplus
extern "C" {
#endif

/* ---- life cycle ---- */

FMI3_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

enum { NOTHING, FOR_CO_SIMULATION_ONLY, NO_EVENT_MODE, NO_INTERMEDIATE_UPDATE, NO_SCHEDULED_EXECUTION };

/* An instance, or NULL with a message, which the importer gets even if logging is off. */
static Instance *instantiate(const char *name, const char *token, Host host, int model_exchange, int logging,
                             int missed, const char *function) {
    Instance probe;
    memset(&probe, 0, sizeof probe);
    probe.host = host;
    probe.categories = EVERY_CATEGORY;
    if (!acceptable(&probe, name, token, function)) return NULL;
    if (missed == FOR_CO_SIMULATION_ONLY) say(&probe, ERROR, SAY_CO_SIMULATION_ONLY, function);
    if (missed == NO_EVENT_MODE) say(&probe, ERROR, SAY_NO_EVENT_MODE, function);
    if (missed == NO_INTERMEDIATE_UPDATE) say(&probe, ERROR, SAY_NO_INTERMEDIATE_UPDATE, function);
    if (missed == NO_SCHEDULED_EXECUTION) say(&probe, ERROR, SAY_NO_SCHEDULED_EXECUTION, function);
    return missed ? NULL : make_instance(&probe, name, host, model_exchange, logging, function);
}

FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                     fmi3Boolean visible, fmi3Boolean logging,
                                                     fmi3Boolean event_mode_used, fmi3Boolean early_return_allowed,
                                                     const fmi3ValueReference intermediate[], size_t n_intermediate,
                                                     fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                     fmi3IntermediateUpdateCallback intermediate_update) {
    const Host host = {environment, log, event_mode_used, early_return_allowed};
    int missed = NOTHING;
    (void)resources;
    (void)visible;
    (void)intermediate;
    (void)intermediate_update;
    if (event_mode_used && KIND != CONTROLLER) missed = NO_EVENT_MODE;
    if (n_intermediate) missed = NO_INTERMEDIATE_UPDATE;
    return instantiate(name, token, host, 0, logging, missed, "fmi3InstantiateCoSimulation");
}

FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                      fmi3Boolean visible, fmi3Boolean logging,
                                                      fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    const Host host = {environment, log, 1, 0};
    (void)resources;
    (void)visible;
    return instantiate(name, token, host, 1, logging, KIND == PLANT ? NOTHING : FOR_CO_SIMULATION_ONLY,
                       "fmi3InstantiateModelExchange");
}

FMI3_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                           fmi3Boolean visible, fmi3Boolean logging,
                                                           fmi3InstanceEnvironment environment,
                                                           fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
                                                           fmi3LockPreemptionCallback lock,
                                                           fmi3UnlockPreemptionCallback unlock) {
    const Host host = {environment, log, 0, 0};
    (void)resources;
    (void)visible;
    (void)update;
    (void)lock;
    (void)unlock;
    return instantiate(name, token, host, 0, logging, NO_SCHEDULED_EXECUTION, "fmi3InstantiateScheduledExecution");
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance c) { free(c); }

FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[]) {
    static const char function[] = "fmi3SetDebugLogging";
    Instance *instance = c;
    unsigned categories;
    if (illegal(instance, MAY_SET_LOGGING, function) || missing(instance, names, n, function)) return fmi3Error;
    categories = n ? named_categories(instance, n, names, function) : EVERY_CATEGORY;
    if (!categories) return fmi3Error;
    instance->categories = on ? instance->categories | categories : instance->categories & ~categories;
    if (!on && n == 0) instance->categories = ONLY_ERRORS;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                                   fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    static const char function[] = "fmi3EnterInitializationMode";
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_INITIALIZATION, function)) return fmi3Error;
    if (set_up(instance, tolerance_defined, tolerance, start, stop_defined, stop, function) != OK) return fmi3Error;
    enter_initialization(instance);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance c) {
    static const char function[] = "fmi3ExitInitializationMode";
    Instance *instance = c;
    if (illegal(instance, MAY_EXIT_INITIALIZATION, function)) return fmi3Error;
    return leave_initialization(instance, instance->host.event_mode_used ? EVENT_MODE : STEP_COMPLETE, function);
}

FMI3_EXPORT fmi3Status fmi3EnterEventMode(fmi3Instance c) {
    static const char function[] = "fmi3EnterEventMode";
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_EVENT_MODE, function)) return fmi3Error;
    if (!instance->host.event_mode_used) {
        say(instance, ERROR, SAY_NO_EVENT_MODE_USED, function);
        return fail(instance);
    }
    instance->s.phase = EVENT_MODE;
    instance->s.outputs_dirty = 1; /* outputs change at a sampling instant even if no input is set */
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance c) { return terminate(c, "fmi3Terminate"); }

FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance c) {
    Instance *instance = c;
    if (illegal(instance, MAY_RESET, "fmi3Reset")) return fmi3Error;
    set_start_values(&instance->s);
    return fmi3OK;
}

/* ---- values ---- */

/* Whether the n variables, all known, have n_values elements in total; if not, it is logged. */
static int sized(Instance *instance, const fmi3ValueReference references[], size_t n, size_t n_values,
                 const char *function) {
    size_t expected = 0;
    for (size_t i = 0; i < n; i++) expected += (size_t)lengths[references[i]];
    if (expected == n_values) return 1;
    say(instance, ERROR, SAY_WRONG_NUMBER, function, (unsigned long)n_values, (unsigned long)expected);
    fail(instance);
    return 0;
}

static int prepare_read(Instance *instance, const fmi3ValueReference references[], size_t n, const void *values,
                        size_t n_values, int type, const char *function) {
    return prepare_get(instance, references, n, values, type, function) ||
           !sized(instance, references, n, n_values, function);
}

static int prepare_write(Instance *instance, const fmi3ValueReference references[], size_t n, const void *values,
                         size_t n_values, int type, const char *function) {
    return prepare_set(instance, references, n, values, type, function) ||
           !sized(instance, references, n, n_values, function);
}

FMI3_EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                      fmi3Float64 values[], size_t n_values) {
    Instance *instance = c;
    int status = OK;
    if (prepare_read(instance, references, n, values, n_values, REAL, "fmi3GetFloat64")) return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        const size_t length = (size_t)lengths[references[i]];
        const double *from =
            variables[references[i]].role == INDEPENDENT ? &instance->s.time : instance->s.v + references[i];
        memcpy(values, from, length * sizeof *values);
        values += length;
        if (status == OK && not_finite(from, (int)length) >= 0)
            status = discard_result(instance, references[i], "fmi3GetFloat64");
    }
    return status;
}

FMI3_EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                      const fmi3Float64 values[], size_t n_values) {
    static const char function[] = "fmi3SetFloat64";
    Instance *instance = c;
    int status = OK;
    if (prepare_write(instance, references, n, values, n_values, REAL, function)) return fmi3Error;
    for (size_t i = 0; i < n; i++)
        for (unsigned k = 0; k < (unsigned)lengths[references[i]] && status != ERROR; k++)
            status = worse(status, set(instance, references[i] + k, *values++, function));
    return status;
}

/* Functions for integers and Booleans, which are never arrays. */
#define GET_AND_SET(NAME, type, kind, value)                                                                   \
    FMI3_EXPORT fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference references[], size_t n,      \
                                         type values[], size_t n_values) {                                     \
        Instance *instance = c;                                                                                \
        if (prepare_read(instance, references, n, values, n_values, kind, "fmi3Get" #NAME)) return fmi3Error;  \
        for (size_t i = 0; i < n; i++) values[i] = (type)(value);                                              \
        return fmi3OK;                                                                                         \
    }                                                                                                          \
    FMI3_EXPORT fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference references[], size_t n,      \
                                         const type values[], size_t n_values) {                               \
        Instance *instance = c;                                                                                \
        int status = OK;                                                                                       \
        if (prepare_write(instance, references, n, values, n_values, kind, "fmi3Set" #NAME)) return fmi3Error; \
        for (size_t i = 0; i < n && status != ERROR; i++)                                                      \
            status = worse(status, set(instance, references[i], (double)values[i], "fmi3Set" #NAME));          \
        return status;                                                                                         \
    }

GET_AND_SET(Int32, fmi3Int32, INTEGER, instance->s.v[references[i]])
GET_AND_SET(Int64, fmi3Int64, ENUMERATION, instance->s.v[references[i]])
GET_AND_SET(Boolean, fmi3Boolean, BOOLEAN, instance->s.v[references[i]] != 0.0)
GET_AND_SET(UInt64, fmi3UInt64, UNSIGNED, counter(&instance->s, references[i] - COUNTER_0))

/* Types of which there are no variables. */
#define NO_VARIABLES(NAME, type, kind)                                                                        \
    FMI3_EXPORT fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference references[], size_t n,     \
                                         type values[], size_t n_values) {                                    \
        return prepare_read(c, references, n, values, n_values, kind, "fmi3Get" #NAME) ? fmi3Error : fmi3OK;  \
    }                                                                                                         \
    FMI3_EXPORT fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference references[], size_t n,     \
                                         const type values[], size_t n_values) {                              \
        return prepare_write(c, references, n, values, n_values, kind, "fmi3Set" #NAME) ? fmi3Error : fmi3OK; \
    }

NO_VARIABLES(Float32, fmi3Float32, FLOAT32)
NO_VARIABLES(Int8, fmi3Int8, INT8)
NO_VARIABLES(UInt8, fmi3UInt8, UINT8)
NO_VARIABLES(Int16, fmi3Int16, INT16)
NO_VARIABLES(UInt16, fmi3UInt16, UINT16)
NO_VARIABLES(UInt32, fmi3UInt32, UINT32)
NO_VARIABLES(String, fmi3String, STRING)

FMI3_EXPORT fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference references[], size_t n, size_t sizes[],
                                     fmi3Binary values[], size_t n_values) {
    (void)sizes;
    return prepare_read(c, references, n, values, n_values, BINARY, "fmi3GetBinary") ? fmi3Error : fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                     const size_t sizes[], const fmi3Binary values[], size_t n_values) {
    (void)sizes;
    return prepare_write(c, references, n, values, n_values, BINARY, "fmi3SetBinary") ? fmi3Error : fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                    fmi3Clock values[]) {
    return prepare_read(c, references, n, values, n, CLOCK, "fmi3GetClock") ? fmi3Error : fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference references[], size_t n,
                                    const fmi3Clock values[]) {
    return prepare_write(c, references, n, values, n, CLOCK, "fmi3SetClock") ? fmi3Error : fmi3OK;
}

/* A function that these FMUs do not offer: a call is an error, and the message gives the reason. */
#define REFUSE(instance, function, text)              \
    do {                                              \
        if (!illegal(instance, MAY_CALL, function)) { \
            say(instance, ERROR, text, function);     \
            fail(instance);                           \
        }                                             \
        return fmi3Error;                             \
    } while (0)
#define NOT_OFFERED(NAME, text, ...) \
    FMI3_EXPORT fmi3Status NAME(fmi3Instance c, __VA_ARGS__) { REFUSE(c, #NAME, text); }

#if defined __clang__ || defined __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NOT_OFFERED(fmi3GetIntervalDecimal, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, fmi3Float64 i[],
            fmi3IntervalQualifier q[])
NOT_OFFERED(fmi3GetIntervalFraction, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, fmi3UInt64 i[],
            fmi3UInt64 u[], fmi3IntervalQualifier q[])
NOT_OFFERED(fmi3GetShiftDecimal, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, fmi3Float64 s[])
NOT_OFFERED(fmi3GetShiftFraction, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, fmi3UInt64 s[], fmi3UInt64 u[])
NOT_OFFERED(fmi3SetIntervalDecimal, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, const fmi3Float64 i[])
NOT_OFFERED(fmi3SetIntervalFraction, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, const fmi3UInt64 i[],
            const fmi3UInt64 u[])
NOT_OFFERED(fmi3SetShiftDecimal, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, const fmi3Float64 s[])
NOT_OFFERED(fmi3SetShiftFraction, SAY_NO_CLOCK, const fmi3ValueReference r[], size_t n, const fmi3UInt64 s[],
            const fmi3UInt64 u[])
NOT_OFFERED(fmi3ActivateModelPartition, SAY_NO_CLOCK, fmi3ValueReference r, fmi3Float64 t)
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, SAY_NO_DEPENDENCIES, fmi3ValueReference r, size_t *n)
NOT_OFFERED(fmi3GetVariableDependencies, SAY_NO_DEPENDENCIES, fmi3ValueReference r, size_t e[], fmi3ValueReference i[],
            size_t f[], fmi3DependencyKind k[], size_t n)
NOT_OFFERED(fmi3GetOutputDerivatives, SAY_NO_OUTPUT_DERIVATIVES, const fmi3ValueReference r[], size_t n,
            const fmi3Int32 o[], fmi3Float64 v[], size_t m)
#if defined __clang__ || defined __GNUC__
#pragma GCC diagnostic pop
#endif

FMI3_EXPORT fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) {
    REFUSE(c, "fmi3EnterConfigurationMode", SAY_NO_STRUCTURE);
}

FMI3_EXPORT fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) {
    REFUSE(c, "fmi3ExitConfigurationMode", SAY_NO_STRUCTURE);
}

/* ---- FMU state ---- */

FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *saved) {
    return save_state(c, saved, "fmi3GetFMUState");
}

FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState saved) {
    return restore_state(c, saved, "fmi3SetFMUState");
}

FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *saved) {
    return free_state(c, saved, "fmi3FreeFMUState");
}

FMI3_EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState saved, size_t *size) {
    return state_size(c, saved, size, "fmi3SerializedFMUStateSize");
}

FMI3_EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState saved, fmi3Byte bytes[], size_t size) {
    return serialize_state(c, saved, bytes, size, "fmi3SerializeFMUState");
}

FMI3_EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size,
                                               fmi3FMUState *saved) {
    return deserialize_state(c, bytes, size, saved, "fmi3DeserializeFMUState");
}

/* ---- derivatives ---- */

/* Whether there are as many seeds or results as variables, none of which is an array; if not, it is logged. */
static int one_each(Instance *instance, size_t n, size_t given, const char *function) {
    if (n == given) return 1;
    say(instance, ERROR, SAY_ONE_EACH, function, (unsigned long)given, (unsigned long)n);
    fail(instance);
    return 0;
}

FMI3_EXPORT fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[],
                                                    size_t n_unknown, const fmi3ValueReference knowns[], size_t n_known,
                                                    const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[],
                                                    size_t n_sensitivity) {
    static const char function[] = "fmi3GetDirectionalDerivative";
    if (illegal(c, MAY_DIFFERENTIATE, function) || !one_each(c, n_known, n_seed, function) ||
        !one_each(c, n_unknown, n_sensitivity, function))
        return fmi3Error;
    return directional_derivative(c, unknowns, n_unknown, knowns, n_known, seed, sensitivity, function);
}

FMI3_EXPORT fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknown,
                                                const fmi3ValueReference knowns[], size_t n_known,
                                                const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[],
                                                size_t n_sensitivity) {
    static const char function[] = "fmi3GetAdjointDerivative";
    double weights[AT_LEAST_1(N_UNKNOWN)] = {0.0};
    double derivatives[AT_LEAST_1(N_UNKNOWN)] = {0.0};
    if (illegal(c, MAY_DIFFERENTIATE, function) || !one_each(c, n_unknown, n_seed, function) ||
        !one_each(c, n_known, n_sensitivity, function))
        return fmi3Error;
    if (missing(c, unknowns, n_unknown, function) || missing(c, knowns, n_known, function) ||
        missing(c, seed, n_seed, function) || missing(c, sensitivity, n_sensitivity, function))
        return fmi3Error;
    for (size_t i = 0; i < n_unknown; i++) {
        const int row = row_of(c, unknowns[i], function);
        if (row < 0) return fmi3Error;
        weights[row] += seed[i];
    }
    for (size_t i = 0; i < n_known; i++) {
        double direction[AT_LEAST_1(N_KNOWN)] = {0.0};
        const int column = column_of(c, knowns[i], function);
        if (column < 0) return fmi3Error;
        direction[column] = 1.0;
        differentiate(&((Instance *)c)->s, direction, derivatives);
        sensitivity[i] = 0.0;
        for (size_t k = 0; k < N_UNKNOWN; k++) sensitivity[i] += weights[k] * derivatives[k];
        if (!isfinite(sensitivity[i])) return discard_result(c, knowns[i], function);
    }
    return fmi3OK;
}

/* ---- events ---- */

#if KIND == CONTROLLER
/* The first sampling instant after the present time of the instance. */
static double next_instant(const State *s) { return instant_ahead(s, at_sampling_instant(s)); }

/* Whether there is a sampling instant between the beginning and the end of a step. *next is the time of the first
   sampling instant after the beginning, on the importer's clock. */
static int instant_within(State *s, double step, double end, double *next) {
    const double behind = at_sampling_instant(s) ? 1.0 : 0.0;
    count_ticks(s, step, end);
    *next = instant_ahead(s, behind);
    if (s->per_sample > 0.0) return s->ahead + behind * s->per_sample < s->fraction.ticks - SAME_TICK;
    return *next < end - same_instant(s);
}
#endif

FMI3_EXPORT fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) {
    return illegal(c, MAY_UPDATE_DISCRETE_STATES, "fmi3EvaluateDiscreteStates") ? fmi3Error : fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *terminate,
                                                fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                                fmi3Boolean *next_event_defined, fmi3Float64 *next_event) {
    static const char function[] = "fmi3UpdateDiscreteStates";
    Instance *instance = c;
    if (illegal(instance, MAY_UPDATE_DISCRETE_STATES, function) || missing(instance, needed, 1, function) ||
        missing(instance, terminate, 1, function) || missing(instance, nominals_changed, 1, function) ||
        missing(instance, states_changed, 1, function) || missing(instance, next_event_defined, 1, function) ||
        missing(instance, next_event, 1, function))
        return fmi3Error;
    *needed = *terminate = *nominals_changed = *states_changed = *next_event_defined = false;
#if KIND == CONTROLLER
    refresh_parameters(&instance->s);
    *next_event_defined = true;
    *next_event = next_instant(&instance->s);
#endif
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3EnterStepMode(fmi3Instance c) {
    static const char function[] = "fmi3EnterStepMode";
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_STEP_MODE, function)) return fmi3Error;
    if (instance->model_exchange) REFUSE(instance, function, SAY_FOR_MODEL_EXCHANGE);
    instance->s.phase = STEP_COMPLETE;
    return fmi3OK;
}

/* ---- model exchange ---- */

FMI3_EXPORT fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) {
    static const char function[] = "fmi3EnterContinuousTimeMode";
    Instance *instance = c;
    if (illegal(instance, MAY_ENTER_CONTINUOUS_TIME, function)) return fmi3Error;
    if (!instance->model_exchange) REFUSE(instance, function, SAY_FOR_CO_SIMULATION);
    return enter_continuous_time(instance, function);
}

FMI3_EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_rollback,
                                                   fmi3Boolean *enter_event_mode, fmi3Boolean *terminate) {
    static const char function[] = "fmi3CompletedIntegratorStep";
    (void)no_rollback;
    if (illegal(c, MAY_COMPLETE_STEP, function) || missing(c, enter_event_mode, 1, function) ||
        missing(c, terminate, 1, function))
        return fmi3Error;
    *enter_event_mode = *terminate = false;
    return completed_step(c);
}

FMI3_EXPORT fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return set_time(c, time, "fmi3SetTime"); }

FMI3_EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    return set_continuous_states(c, x, n, "fmi3SetContinuousStates");
}

FMI3_EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return continuous_states(c, x, n, "fmi3GetContinuousStates");
}

FMI3_EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 derivatives[], size_t n) {
    return state_derivatives(c, derivatives, n, "fmi3GetContinuousStateDerivatives");
}

FMI3_EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n) {
    return event_indicators(c, indicators, n, "fmi3GetEventIndicators");
}

FMI3_EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 values[], size_t n) {
    return state_nominals(c, values, n, "fmi3GetNominalsOfContinuousStates");
}

FMI3_EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) {
    static const char function[] = "fmi3GetNumberOfEventIndicators";
    if (illegal(c, MAY_CALL, function) || missing(c, n, 1, function)) return fmi3Error;
    *n = 0;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) {
    static const char function[] = "fmi3GetNumberOfContinuousStates";
    if (illegal(c, MAY_CALL, function) || missing(c, n, 1, function)) return fmi3Error;
    *n = N_CONTINUOUS;
    return fmi3OK;
}

/* ---- stepping ---- */

FMI3_EXPORT fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_rollback,
                                  fmi3Boolean *event_handling_needed, fmi3Boolean *terminate, fmi3Boolean *early_return,
                                  fmi3Float64 *last_successful_time) {
    static const char function[] = "fmi3DoStep";
    Instance *instance = c;
    int status;
    (void)no_rollback;
    if (illegal(instance, MAY_STEP, function) || missing(instance, event_handling_needed, 1, function) ||
        missing(instance, terminate, 1, function) || missing(instance, early_return, 1, function) ||
        missing(instance, last_successful_time, 1, function))
        return fmi3Error;
    *event_handling_needed = *terminate = *early_return = false;
    *last_successful_time = instance->s.time;
    if (!steppable(instance, time, step, function)) return fmi3Error;
#if KIND == CONTROLLER
    if (instance->host.event_mode_used && instance->host.early_return_allowed) {
        double next;
        instance->s.time = time;
        *early_return = instant_within(&instance->s, step, time + step, &next);
        if (*early_return) step = next - time;
    }
#endif
    status = step_to(instance, time, step, function);
    *last_successful_time = instance->s.time;
    if (status != OK) return status;
#if KIND == CONTROLLER
    *event_handling_needed = instance->host.event_mode_used && at_sampling_instant(&instance->s);
#endif
    return fmi3OK;
}

#ifdef __cplusplus
}
#endif
