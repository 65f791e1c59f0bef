/* FMI 2.0 co-simulation, and model exchange for plants, of one component; included by the generated model.c.

   model.c defines the sizes, the table of variables, the traced functions and their variants. A variable's value
   reference is its index in State.v, whose order is parameters, inputs, states, outputs, derivatives, solver counters.
   All that an instance remembers is in State, so copying an FMU state is copying that struct. */
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"
#if KIND == PLANT
#include "integrator.c"
#else
#include "integrator.h"
#endif

#define INPUT_0 N_PARAMETERS
#define STATE_0 (INPUT_0 + N_INPUTS)
#define OUTPUT_0 (STATE_0 + N_STATES)
#define DERIVATIVE_0 (OUTPUT_0 + N_OUTPUTS)
#define COUNTER_0 (DERIVATIVE_0 + N_CONTINUOUS)
#define N_KNOWN (N_CONTINUOUS + N_INPUTS)
#define AT_LEAST_1(n) ((n) > 0 ? (n) : 1)
#define MAX_STEPS 10000000L

typedef enum { INSTANTIATED = 1, INITIALIZATION = 2, STEP_COMPLETE = 4, STEP_FAILED = 8, TERMINATED = 16, FAILED = 32,
               EVENT_MODE = 64, CONTINUOUS_TIME = 128 } Phase;
#define EXCHANGE (EVENT_MODE | CONTINUOUS_TIME)
#define EVALUATED (INITIALIZATION | STEP_COMPLETE | STEP_FAILED | EXCHANGE)
#define READABLE (EVALUATED | TERMINATED | FAILED)
#define WRITABLE (INSTANTIATED | INITIALIZATION | STEP_COMPLETE | EXCHANGE)
#define ANY (INSTANTIATED | READABLE)

typedef struct {
    double v[N_VARIABLES];
    double next[AT_LEAST_1(N_STATES)];      /* controller: state of the next sample, valid while sampled */
    double c[AT_LEAST_1(N_CONSTANTS)];      /* derived from parameters */
    double start;                           /* s */
    double time;                            /* s, reached by the last step */
    double stop;                            /* s, infinite if not defined */
    double tolerance;                       /* from fmi2SetupExperiment, 0 if not defined */
    unsigned long long sample;              /* controller: index of the next sampling instant */
    Integrator integrator;
    int variant;
    int phase;
    int tolerance_set;    /* the parameter tolerance was set by the importer */
    int parameters_dirty; /* constants, variant and (before the first step) the initial state are to be computed */
    int outputs_dirty;
    int derivatives_dirty;
    int sampled;          /* controller: outputs and next belong to the inputs at the coming sampling instant */
} State;

typedef struct {
    State s;
    char *name;
    fmi2CallbackFunctions callbacks;
    int model_exchange;
    int logging;
    unsigned categories; /* bit of each category that is logged */
} Instance;

static const char *const category_names[] = {"logStatusWarning", "logStatusDiscard", "logStatusError", "logAll"};
enum { LOG_WARNING, LOG_DISCARD, LOG_ERROR, LOG_ALL, N_CATEGORIES };

/* ---- messages ---- */

static void say(const Instance *instance, fmi2Status status, const char *format, ...) {
    char text[1024];
    va_list arguments;
    const unsigned category = status == fmi2Warning ? LOG_WARNING : status == fmi2Discard ? LOG_DISCARD : LOG_ERROR;
    if (!instance->logging || !instance->callbacks.logger) return;
    if (!(instance->categories & (1u << category | 1u << LOG_ALL))) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    for (char *p = text; *p; p++)
        if (*p == '%') *p = '#'; /* some importers take the message as a format, others print it as it is */
    instance->callbacks.logger(instance->callbacks.componentEnvironment, instance->name, status,
                               category_names[category], text);
}

static fmi2Status fail(Instance *instance) {
    instance->s.phase = FAILED;
    return fmi2Error;
}

static const char *phase_name(int phase) {
    switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZATION: return "initialization mode";
    case STEP_COMPLETE: return "step complete";
    case STEP_FAILED: return "step failed";
    case TERMINATED: return "terminated";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME: return "continuous-time mode";
    default: return "error";
    }
}

/* Whether a call is legal now; if not it is logged and the instance fails. */
static int illegal(Instance *instance, int phases, const char *function) {
    if (!instance) return 1;
    if (instance->s.phase & phases) return 0;
    say(instance, fmi2Error, "%s: not allowed in state '%s'. Follow the FMI 2.0 calling sequence, or reset the instance.",
        function, phase_name(instance->s.phase));
    fail(instance);
    return 1;
}

static int missing(Instance *instance, const void *pointer, size_t n, const char *function) {
    if (pointer || n == 0) return 0;
    say(instance, fmi2Error, "%s: an argument is NULL. Pass an array of %lu elements.", function, (unsigned long)n);
    fail(instance);
    return 1;
}

/* ---- evaluation ---- */

static double *parameters(State *s) { return s->v; }
static double *inputs(State *s) { return s->v + INPUT_0; }
static double *states(State *s) { return s->v + STATE_0; }
static double *outputs(State *s) { return s->v + OUTPUT_0; }

static const Variant *variant(const State *s) { return &variants[s->variant]; }

static int variant_index(const double *p) {
    int index = 0;
#if N_CHOICES > 0
    for (int i = 0; i < N_CHOICES; i++) index = index * choices[i].count + (int)p[choices[i].parameter] - choices[i].first;
#else
    (void)p;
#endif
    return index;
}

static void refresh_parameters(State *s) {
    if (!s->parameters_dirty) return;
    s->variant = variant_index(parameters(s));
    variant(s)->constants(s->time, NULL, NULL, parameters(s), NULL, s->c);
    if (s->phase & (INSTANTIATED | INITIALIZATION))
        variant(s)->initial(s->start, NULL, NULL, parameters(s), NULL, states(s));
    s->parameters_dirty = 0;
}

static int broken_rule(State *s) {
#if N_RULES > 0
    double holds[N_RULES];
    variants[variant_index(parameters(s))].rules(s->time, NULL, NULL, parameters(s), NULL, holds);
    for (int i = 0; i < N_RULES; i++)
        if (holds[i] == 0.0) return i;
#else
    (void)s;
#endif
    return -1;
}

#if KIND == CONTROLLER
static double sampling_time(const State *s) { return s->v[PARAMETER_T_S]; }
static double sampling_instant(const State *s) { return s->start + (double)s->sample * sampling_time(s); }
/* Two times are one sampling instant if they differ by rounding only. */
static double same_instant(const State *s) {
    const double rounding = 1e-6 * sampling_time(s) + 8.0 * DBL_EPSILON * fabs(s->time);
    return rounding < 0.25 * sampling_time(s) ? rounding : 0.25 * sampling_time(s);
}

static void take_sample(State *s, double t) {
    variant(s)->sample(t, states(s), inputs(s), parameters(s), s->c, outputs(s), s->next);
    s->sampled = 1;
    s->outputs_dirty = 0;
}
#endif

/* Bring what an importer may read up to date with inputs, parameters and time. */
static void refresh(State *s, int derivatives) {
    refresh_parameters(s);
    if (s->outputs_dirty) {
#if KIND == CONTROLLER
        if (fabs(s->time - sampling_instant(s)) <= same_instant(s)) take_sample(s, sampling_instant(s));
#else
        variant(s)->output(s->time, states(s), inputs(s), parameters(s), s->c, outputs(s));
#endif
        s->outputs_dirty = 0;
    }
#if N_CONTINUOUS > 0
    if (derivatives && s->derivatives_dirty) {
        variant(s)->derivative(s->time, states(s), inputs(s), parameters(s), s->c, s->v + DERIVATIVE_0);
        s->derivatives_dirty = 0;
    }
#else
    (void)derivatives;
#endif
}

static void touch(State *s) {
    s->outputs_dirty = s->derivatives_dirty = 1;
    s->sampled = 0;
}

/* Index of the first value that is not finite, else -1. */
static int not_finite(const double *x, int n) {
    double zero = 0.0;
    for (int i = 0; i < n; i++) zero += 0.0 * x[i];
    if (zero == 0.0) return -1;
    for (int i = 0; i < n; i++)
        if (!isfinite(x[i])) return i;
    return -1;
}

/* ---- life cycle ---- */

static void set_start_values(State *s) {
    memset(s, 0, sizeof *s);
    for (int i = 0; i < N_VARIABLES; i++) s->v[i] = variables[i].start;
    s->phase = INSTANTIATED;
    s->stop = INFINITY;
    s->parameters_dirty = 1;
    touch(s);
}

FMI2_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI2_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    Instance probe;
    Instance *instance;
    size_t length;
    (void)resources;
    (void)visible;
    if (!callbacks) return NULL;
    memset(&probe, 0, sizeof probe);
    probe.callbacks = *callbacks;
    probe.logging = 1; /* a refusal to exist is always said */
    probe.categories = ~0u;
    probe.name = (char *)(name ? name : "");
    if (!name || !*name) {
        say(&probe, fmi2Error, "fmi2Instantiate: the instance name is empty. Give one.");
        return NULL;
    }
    if (!guid || strcmp(guid, MODEL_GUID) != 0) {
        say(&probe, fmi2Error, "fmi2Instantiate: guid is '%s', this binary has '%s'. Use the modelDescription.xml of this FMU.",
            guid ? guid : "", MODEL_GUID);
        return NULL;
    }
    if (type != fmi2CoSimulation && !(KIND == PLANT && type == fmi2ModelExchange)) {
        say(&probe, fmi2Error, "fmi2Instantiate: " MODEL_NAME " is a co-simulation FMU. Instantiate it with fmi2CoSimulation.");
        return NULL;
    }
    if (!callbacks->allocateMemory != !callbacks->freeMemory) {
        say(&probe, fmi2Error, "fmi2Instantiate: only one of allocateMemory and freeMemory is given. Give both or none.");
        return NULL;
    }
    length = strlen(name) + 1;
    instance = callbacks->allocateMemory ? callbacks->allocateMemory(1, sizeof *instance + length)
                                         : calloc(1, sizeof *instance + length);
    if (!instance) {
        say(&probe, fmi2Error, "fmi2Instantiate: out of memory.");
        return NULL;
    }
    memset(instance, 0, sizeof *instance);
    instance->name = (char *)(instance + 1);
    memcpy(instance->name, name, length);
    instance->callbacks = *callbacks;
    instance->model_exchange = type == fmi2ModelExchange;
    instance->logging = logging != 0;
    instance->categories = ~0u;
    set_start_values(&instance->s);
    return instance;
}

FMI2_EXPORT void fmi2FreeInstance(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return;
    if (instance->callbacks.freeMemory) instance->callbacks.freeMemory(instance);
    else free(instance);
}

FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    Instance *instance = c;
    unsigned categories = 0;
    if (illegal(instance, ANY, "fmi2SetDebugLogging") || missing(instance, names, n, "fmi2SetDebugLogging")) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        unsigned k = 0;
        while (k < N_CATEGORIES && (!names[i] || strcmp(names[i], category_names[k]) != 0)) k++;
        if (k == N_CATEGORIES) {
            say(instance, fmi2Error, "fmi2SetDebugLogging: unknown category '%s'. Use those of modelDescription.xml.",
                names[i] ? names[i] : "");
            return fail(instance);
        }
        categories |= 1u << k;
    }
    instance->logging = on != 0;
    instance->categories = n ? categories : ~0u;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *instance = c;
    if (illegal(instance, INSTANTIATED, "fmi2SetupExperiment")) return fmi2Error;
    if (!isfinite(start) || (stop_defined && !(isfinite(stop) && stop > start))) {
        say(instance, fmi2Error, "fmi2SetupExperiment: start time %g s, stop time %g s: give finite times, stop after start.",
            start, stop_defined ? stop : start);
        return fail(instance);
    }
    if (tolerance_defined && !(isfinite(tolerance) && tolerance > 0.0)) {
        say(instance, fmi2Error, "fmi2SetupExperiment: tolerance %g: give a positive number.", tolerance);
        return fail(instance);
    }
    instance->s.start = instance->s.time = start;
    instance->s.stop = stop_defined ? stop : INFINITY;
    instance->s.tolerance = tolerance_defined ? tolerance : 0.0;
    instance->s.parameters_dirty = 1;
    touch(&instance->s);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, INSTANTIATED, "fmi2EnterInitializationMode")) return fmi2Error;
    instance->s.phase = INITIALIZATION;
#if KIND == PLANT
    if (instance->s.tolerance > 0.0 && !instance->s.tolerance_set)
        instance->s.v[PARAMETER_TOLERANCE] = fmin(fmax(instance->s.tolerance, variables[PARAMETER_TOLERANCE].min),
                                                  variables[PARAMETER_TOLERANCE].max);
#endif
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *instance = c;
    State *s;
    int i;
    if (illegal(instance, INITIALIZATION, "fmi2ExitInitializationMode")) return fmi2Error;
    s = &instance->s;
    i = broken_rule(s);
    if (i >= 0) {
        say(instance, fmi2Error, "fmi2ExitInitializationMode: %s", rule_texts[i]);
        return fail(instance);
    }
    refresh_parameters(s);
    i = not_finite(states(s), N_STATES);
    if (i >= 0) {
        say(instance, fmi2Error, "fmi2ExitInitializationMode: the initial %s is not finite. Check the parameters.",
            variables[STATE_0 + i].name);
        return fail(instance);
    }
    touch(s);
    s->phase = instance->model_exchange ? EVENT_MODE : STEP_COMPLETE;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, STEP_COMPLETE | STEP_FAILED | EXCHANGE, "fmi2Terminate")) return fmi2Error;
    instance->s.phase = TERMINATED;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2Reset")) return fmi2Error;
    set_start_values(&instance->s);
    return fmi2OK;
}

/* ---- values ---- */

static int unknown(Instance *instance, fmi2ValueReference reference, int type, const char *function) {
    static const char *const types[] = {"Real", "Integer", "Boolean", "String"};
    if (reference >= N_VARIABLES) {
        say(instance, fmi2Error, "%s: unknown value reference %u. " MODEL_NAME " has 0 to %d.", function, reference,
            N_VARIABLES - 1);
        fail(instance);
        return 1;
    }
    if (variables[reference].type != type) {
        say(instance, fmi2Error, "%s: %s (value reference %u) is of type %s. Use fmi2Get%s or fmi2Set%s.", function,
            variables[reference].name, reference, types[variables[reference].type], types[variables[reference].type],
            types[variables[reference].type]);
        fail(instance);
        return 1;
    }
    return 0;
}

static int prepare_get(Instance *instance, const fmi2ValueReference references[], size_t n, const void *values, int type,
                       const char *function) {
    int derivatives = 0;
    if (illegal(instance, READABLE, function) || missing(instance, references, n, function) ||
        missing(instance, values, n, function))
        return 1;
    for (size_t i = 0; i < n; i++) {
        if (unknown(instance, references[i], type, function)) return 1;
        derivatives |= variables[references[i]].role == DERIVATIVE;
    }
    if (instance->s.phase & EVALUATED) refresh(&instance->s, derivatives);
    return 0;
}

FMI2_EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Real values[]) {
    Instance *instance = c;
#if PLAIN_OUTPUTS /* what happens at every step, in one pass */
    if (instance && references && values && instance->s.phase & EVALUATED) {
        size_t i = 0;
        refresh(&instance->s, 0);
        while (i < n && references[i] - STATE_0 < N_STATES + N_OUTPUTS) {
            values[i] = instance->s.v[references[i]];
            i++;
        }
        if (i == n) return fmi2OK;
    }
#endif
    if (prepare_get(instance, references, n, values, REAL, "fmi2GetReal")) return fmi2Error;
    for (size_t i = 0; i < n; i++) values[i] = instance->s.v[references[i]];
    return fmi2OK;
}

static double counter(const State *s, size_t index) {
    const unsigned long long counts[] = {s->integrator.steps, s->integrator.rejected, s->integrator.derivatives,
                                         s->integrator.jacobians, s->integrator.decompositions};
    return counts[index] > 2147483647u ? 2147483647.0 : (double)counts[index];
}

FMI2_EXPORT fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      fmi2Integer values[]) {
    Instance *instance = c;
    if (prepare_get(instance, references, n, values, INTEGER, "fmi2GetInteger")) return fmi2Error;
    for (size_t i = 0; i < n; i++)
        values[i] = (fmi2Integer)(variables[references[i]].role == COUNTER
                                      ? counter(&instance->s, references[i] - COUNTER_0)
                                      : instance->s.v[references[i]]);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      fmi2Boolean values[]) {
    Instance *instance = c;
    if (prepare_get(instance, references, n, values, BOOLEAN, "fmi2GetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n; i++) values[i] = instance->s.v[references[i]] != 0.0;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2String values[]) {
    return prepare_get(c, references, n, values, STRING, "fmi2GetString") ? fmi2Error : fmi2OK;
}

/* Whether a variable may take a value now: fmi2OK, or the status to return, with a message. */
static fmi2Status refused(Instance *instance, fmi2ValueReference reference, double value, const char *function) {
    const Variable *variable = &variables[reference];
    const int before = instance->s.phase & (INSTANTIATED | INITIALIZATION);
    if (variable->role != INPUT && variable->role != TUNABLE && !(variable->role == FIXED && before)) {
        say(instance, fmi2Error, "%s: %s %s.", function, variable->name,
            variable->role == FIXED ? "is a fixed parameter. Set it before initialization ends"
                                    : "is computed by the FMU. Set inputs and parameters only");
        return fail(instance);
    }
    if (variable->role == TUNABLE && instance->s.phase == CONTINUOUS_TIME) {
        say(instance, fmi2Error, "%s: %s is a tunable parameter. Set it in event mode.", function, variable->name);
        return fail(instance);
    }
    if (isfinite(value) && value >= variable->min && value <= variable->max) return fmi2OK;
    if (!isfinite(value))
        say(instance, fmi2Discard, "%s: %s = %g %s: must be finite. The previous value %g is kept.", function,
            variable->name, value, variable->unit, instance->s.v[reference]);
    else
        say(instance, fmi2Discard, "%s: %s = %.17g %s: %s %.17g %s. The previous value %g is kept.", function,
            variable->name, value, variable->unit, value < variable->min ? "below its minimum" : "above its maximum",
            value < variable->min ? variable->min : variable->max, variable->unit, instance->s.v[reference]);
    return fmi2Discard;
}

static fmi2Status set(Instance *instance, fmi2ValueReference reference, double value, const char *function) {
    State *s = &instance->s;
    const fmi2Status status = refused(instance, reference, value, function);
    const double previous = s->v[reference];
    if (status != fmi2OK) return status;
    s->v[reference] = value;
    touch(s);
    if (variables[reference].role == INPUT) return fmi2OK;
    s->parameters_dirty = 1;
#if KIND == PLANT
    if (reference == PARAMETER_TOLERANCE) s->tolerance_set = 1;
#endif
    if (s->phase == STEP_COMPLETE || s->phase == EVENT_MODE) {
        const int rule = broken_rule(s);
        if (rule >= 0) {
            say(instance, fmi2Discard, "%s: %s = %g %s: %s The previous value %g is kept.", function,
                variables[reference].name, value, variables[reference].unit, rule_texts[rule], previous);
            s->v[reference] = previous;
            return fmi2Discard;
        }
    }
    return fmi2OK;
}

static int prepare_set(Instance *instance, const fmi2ValueReference references[], size_t n, const void *values, int type,
                       const char *function) {
    if (illegal(instance, WRITABLE, function) || missing(instance, references, n, function) ||
        missing(instance, values, n, function))
        return 1;
    for (size_t i = 0; i < n; i++)
        if (unknown(instance, references[i], type, function)) return 1;
    return 0;
}

static fmi2Status worse(fmi2Status one, fmi2Status other) { return one > other ? one : other; }

FMI2_EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                   const fmi2Real values[]) {
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    size_t i = 0;
#if PLAIN_INPUTS /* what happens at every step, in one pass */
    if (instance && references && values && instance->s.phase & WRITABLE) {
        while (i < n && references[i] - INPUT_0 < N_INPUTS && fabs(values[i]) <= DBL_MAX) {
            instance->s.v[references[i]] = values[i];
            i++;
        }
        touch(&instance->s);
        if (i == n) return fmi2OK;
    }
#endif
    if (prepare_set(instance, references, n, values, REAL, "fmi2SetReal")) return fmi2Error;
    for (; i < n && status != fmi2Error; i++) status = worse(status, set(instance, references[i], values[i], "fmi2SetReal"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      const fmi2Integer values[]) {
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (prepare_set(instance, references, n, values, INTEGER, "fmi2SetInteger")) return fmi2Error;
    for (size_t i = 0; i < n && status != fmi2Error; i++)
        status = worse(status, set(instance, references[i], values[i], "fmi2SetInteger"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                      const fmi2Boolean values[]) {
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (prepare_set(instance, references, n, values, BOOLEAN, "fmi2SetBoolean")) return fmi2Error;
    for (size_t i = 0; i < n && status != fmi2Error; i++)
        status = worse(status, set(instance, references[i], values[i] != 0, "fmi2SetBoolean"));
    return status;
}

FMI2_EXPORT fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                     const fmi2String values[]) {
    return prepare_set(c, references, n, values, STRING, "fmi2SetString") ? fmi2Error : fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                   const fmi2Integer orders[], const fmi2Real values[]) {
    Instance *instance = c;
    (void)references;
    (void)orders;
    (void)values;
    if (illegal(instance, WRITABLE, "fmi2SetRealInputDerivatives")) return fmi2Error;
    if (n == 0) return fmi2OK;
    say(instance, fmi2Error, "fmi2SetRealInputDerivatives: inputs are held over a step (canInterpolateInputs is false).");
    return fail(instance);
}

FMI2_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                    const fmi2Integer orders[], fmi2Real values[]) {
    Instance *instance = c;
    (void)references;
    (void)orders;
    (void)values;
    if (illegal(instance, READABLE, "fmi2GetRealOutputDerivatives")) return fmi2Error;
    if (n == 0) return fmi2OK;
    say(instance, fmi2Error, "fmi2GetRealOutputDerivatives: not provided (maxOutputDerivativeOrder is 0).");
    return fail(instance);
}

/* ---- FMU state ---- */

typedef struct {
    char guid[40];
    unsigned long long size;
    int model_exchange;
    State s;
} Saved;

FMI2_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    Instance *instance = c;
    Saved *copy;
    if (illegal(instance, ANY, "fmi2GetFMUstate") || missing(instance, saved, 1, "fmi2GetFMUstate")) return fmi2Error;
    copy = *saved ? *saved : calloc(1, sizeof *copy);
    if (!copy) {
        say(instance, fmi2Error, "fmi2GetFMUstate: out of memory.");
        return fail(instance);
    }
    memset(copy, 0, sizeof *copy);
    strncpy(copy->guid, MODEL_GUID, sizeof copy->guid - 1);
    copy->size = sizeof *copy;
    copy->model_exchange = instance->model_exchange;
    memcpy(&copy->s, &instance->s, sizeof copy->s);
    *saved = copy;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2SetFMUstate") || missing(instance, saved, 1, "fmi2SetFMUstate")) return fmi2Error;
    if (((const Saved *)saved)->model_exchange != instance->model_exchange) {
        say(instance, fmi2Error, "fmi2SetFMUstate: the state is that of an instance for %s. Use one of the same kind.",
            instance->model_exchange ? "co-simulation" : "model exchange");
        return fail(instance);
    }
    memcpy(&instance->s, &((const Saved *)saved)->s, sizeof instance->s);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2FreeFMUstate")) return fmi2Error;
    if (!saved) return fmi2OK;
    free(*saved);
    *saved = NULL;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2SerializedFMUstateSize") || missing(instance, saved, 1, "fmi2SerializedFMUstateSize") ||
        missing(instance, size, 1, "fmi2SerializedFMUstateSize"))
        return fmi2Error;
    *size = sizeof(Saved);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2SerializeFMUstate") || missing(instance, saved, 1, "fmi2SerializeFMUstate") ||
        missing(instance, bytes, size, "fmi2SerializeFMUstate"))
        return fmi2Error;
    if (size < sizeof(Saved)) {
        say(instance, fmi2Error, "fmi2SerializeFMUstate: %lu bytes are too few. Give fmi2SerializedFMUstateSize, %lu.",
            (unsigned long)size, (unsigned long)sizeof(Saved));
        return fail(instance);
    }
    memcpy(bytes, saved, sizeof(Saved));
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved) {
    Instance *instance = c;
    Saved *copy;
    if (illegal(instance, ANY, "fmi2DeSerializeFMUstate") || missing(instance, bytes, size, "fmi2DeSerializeFMUstate") ||
        missing(instance, saved, 1, "fmi2DeSerializeFMUstate"))
        return fmi2Error;
    if (size < sizeof(Saved) || strncmp(bytes, MODEL_GUID, sizeof((Saved *)0)->guid) != 0 ||
        memcmp(bytes + offsetof(Saved, size), &(unsigned long long){sizeof(Saved)}, sizeof(unsigned long long)) != 0) {
        say(instance, fmi2Error, "fmi2DeSerializeFMUstate: these %lu bytes are no state of this FMU. Pass what "
            "fmi2SerializeFMUstate of the same FMU and platform gave.", (unsigned long)size);
        return fail(instance);
    }
    copy = *saved ? *saved : calloc(1, sizeof *copy);
    if (!copy) {
        say(instance, fmi2Error, "fmi2DeSerializeFMUstate: out of memory.");
        return fail(instance);
    }
    memcpy(copy, bytes, sizeof *copy);
    *saved = copy;
    return fmi2OK;
}

/* ---- derivatives ---- */

FMI2_EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknown,
                                                    const fmi2ValueReference knowns[], size_t n_known,
                                                    const fmi2Real seed[], fmi2Real result[]) {
    static const char function[] = "fmi2GetDirectionalDerivative";
    Instance *instance = c;
    double partials[AT_LEAST_1((N_CONTINUOUS + N_OUTPUTS) * N_KNOWN)];
    double direction[AT_LEAST_1(N_KNOWN)] = {0.0};
    if (illegal(instance, READABLE, function) || missing(instance, unknowns, n_unknown, function) ||
        missing(instance, knowns, n_known, function) || missing(instance, seed, n_known, function) ||
        missing(instance, result, n_unknown, function))
        return fmi2Error;
    for (size_t i = 0; i < n_known; i++) {
        const fmi2ValueReference r = knowns[i];
        if (unknown(instance, r, REAL, function)) return fmi2Error;
        if (variables[r].role == INPUT) direction[N_CONTINUOUS + r - INPUT_0] += seed[i];
        else if (variables[r].role == STATE && r - STATE_0 < N_CONTINUOUS) direction[r - STATE_0] += seed[i];
        else {
            say(instance, fmi2Error, "%s: %s is no known variable. Differentiate with respect to inputs and continuous "
                "states.", function, variables[r].name);
            return fail(instance);
        }
    }
    refresh_parameters(&instance->s);
#if KIND == CONTROLLER
    variant(&instance->s)->partials(sampling_instant(&instance->s), states(&instance->s), inputs(&instance->s),
                                    parameters(&instance->s), instance->s.c, partials);
#else
    variant(&instance->s)->partials(instance->s.time, states(&instance->s), inputs(&instance->s),
                                    parameters(&instance->s), instance->s.c, partials);
#endif
    for (size_t i = 0; i < n_unknown; i++) {
        const fmi2ValueReference r = unknowns[i];
        size_t row;
        if (unknown(instance, r, REAL, function)) return fmi2Error;
        if (variables[r].role == DERIVATIVE) row = r - DERIVATIVE_0;
        else if (variables[r].role == OUTPUT) row = N_CONTINUOUS + r - OUTPUT_0;
        else {
            say(instance, fmi2Error, "%s: %s is no unknown variable. Differentiate outputs and state derivatives.",
                function, variables[r].name);
            return fail(instance);
        }
        result[i] = 0.0;
        for (size_t k = 0; k < N_KNOWN; k++) result[i] += partials[row * N_KNOWN + k] * direction[k];
    }
    return fmi2OK;
}

/* ---- model exchange ---- */

FMI2_EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, CONTINUOUS_TIME, "fmi2EnterEventMode")) return fmi2Error;
    instance->s.phase = EVENT_MODE;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, EVENT_MODE, "fmi2EnterContinuousTimeMode")) return fmi2Error;
    refresh_parameters(&instance->s);
    instance->s.phase = CONTINUOUS_TIME;
    return fmi2OK;
}

/* There are no events: inputs may jump at any event mode, and discrete states follow accepted steps. */
FMI2_EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Instance *instance = c;
    if (illegal(instance, EVENT_MODE, "fmi2NewDiscreteStates") || missing(instance, info, 1, "fmi2NewDiscreteStates"))
        return fmi2Error;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_rollback, fmi2Boolean *enter_event_mode,
                                                   fmi2Boolean *terminate) {
    Instance *instance = c;
    State *s;
    (void)no_rollback;
    if (illegal(instance, CONTINUOUS_TIME, "fmi2CompletedIntegratorStep") ||
        missing(instance, enter_event_mode, 1, "fmi2CompletedIntegratorStep") ||
        missing(instance, terminate, 1, "fmi2CompletedIntegratorStep"))
        return fmi2Error;
    s = &instance->s;
    *enter_event_mode = *terminate = fmi2False;
    s->integrator.steps++;
#if KIND == PLANT
    if (N_STATES > N_CONTINUOUS) {
        variant(s)->update(s->time, states(s), inputs(s), parameters(s), s->c);
        touch(s);
    }
#endif
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Instance *instance = c;
    if (illegal(instance, EXCHANGE, "fmi2SetTime")) return fmi2Error;
    if (!isfinite(time)) {
        say(instance, fmi2Error, "fmi2SetTime: %g s. Give a finite time.", time);
        return fail(instance);
    }
    instance->s.time = time;
    touch(&instance->s);
    return fmi2OK;
}

/* Whether an array of continuous states or event indicators has the wrong length or is NULL. */
static int wrong_length(Instance *instance, const void *values, size_t n, size_t expected, const char *function) {
    if (n == expected) return missing(instance, values, n, function);
    say(instance, fmi2Error, "%s: an array of %lu elements, but " MODEL_NAME " has %lu. Pass one of that length.", function,
        (unsigned long)n, (unsigned long)expected);
    fail(instance);
    return 1;
}

FMI2_EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    Instance *instance = c;
    int i;
    if (illegal(instance, EXCHANGE, "fmi2SetContinuousStates") ||
        wrong_length(instance, x, n, N_CONTINUOUS, "fmi2SetContinuousStates"))
        return fmi2Error;
    i = not_finite(x, N_CONTINUOUS);
    if (i >= 0) {
        say(instance, fmi2Discard, "fmi2SetContinuousStates: %s = %g: must be finite. The previous states are kept.",
            variables[STATE_0 + i].name, x[i]);
        return fmi2Discard;
    }
    for (i = 0; i < N_CONTINUOUS; i++) states(&instance->s)[i] = x[i];
    touch(&instance->s);
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *instance = c;
    if (illegal(instance, INITIALIZATION | EXCHANGE | TERMINATED | FAILED, "fmi2GetContinuousStates") ||
        wrong_length(instance, x, n, N_CONTINUOUS, "fmi2GetContinuousStates"))
        return fmi2Error;
    refresh_parameters(&instance->s);
    for (int i = 0; i < N_CONTINUOUS; i++) x[i] = states(&instance->s)[i];
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t n) {
    Instance *instance = c;
    State *s;
    int i;
    if (illegal(instance, INITIALIZATION | EXCHANGE | TERMINATED | FAILED, "fmi2GetDerivatives") ||
        wrong_length(instance, derivatives, n, N_CONTINUOUS, "fmi2GetDerivatives"))
        return fmi2Error;
    s = &instance->s;
    s->integrator.derivatives += s->derivatives_dirty != 0;
    refresh(s, 1);
    for (i = 0; i < N_CONTINUOUS; i++) derivatives[i] = s->v[DERIVATIVE_0 + i];
    i = not_finite(derivatives, N_CONTINUOUS);
    if (i < 0) return fmi2OK;
    say(instance, fmi2Discard, "fmi2GetDerivatives: %s is not finite at t = %.17g s. Check inputs and states, or take a "
        "smaller step.", variables[DERIVATIVE_0 + i].name, s->time);
    return fmi2Discard;
}

FMI2_EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n) {
    Instance *instance = c;
    if (illegal(instance, INITIALIZATION | EXCHANGE | TERMINATED | FAILED, "fmi2GetEventIndicators") ||
        wrong_length(instance, indicators, n, 0, "fmi2GetEventIndicators"))
        return fmi2Error;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real values[], size_t n) {
    Instance *instance = c;
    if (illegal(instance, INSTANTIATED | INITIALIZATION | EXCHANGE | TERMINATED | FAILED,
                "fmi2GetNominalsOfContinuousStates") ||
        wrong_length(instance, values, n, N_CONTINUOUS, "fmi2GetNominalsOfContinuousStates"))
        return fmi2Error;
#if KIND == PLANT
    for (int i = 0; i < N_CONTINUOUS; i++) values[i] = nominals[i];
#endif
    return fmi2OK;
}

/* ---- stepping ---- */

#if KIND == PLANT
static fmi2Status advance(Instance *instance, double end) {
    State *s = &instance->s;
    Problem problem = {variant(s)->derivative, variant(s)->jacobian, N_STATES > N_CONTINUOUS ? variant(s)->update : NULL,
                       inputs(s), parameters(s), s->c, nominals, s->v[PARAMETER_TOLERANCE], MAX_STEPS};
    const int code = integrate(&problem, &s->integrator, s->time, end, states(s));
    if (code == INTEGRATE_OK) {
        s->time = end;
        return fmi2OK;
    }
    s->time = s->integrator.time;
    s->phase = STEP_FAILED;
    say(instance, fmi2Discard, "fmi2DoStep: integration stopped at t = %.17g s, %s (%s). %s", s->time,
        code == INTEGRATE_TOO_MANY_STEPS ? "too many steps"
        : code == INTEGRATE_NOT_FINITE   ? "a derivative is not finite"
                                         : "the step size became too small",
        s->integrator.failing >= 0 ? variables[STATE_0 + s->integrator.failing].name : "no single state",
        "Check inputs and parameters, or enlarge the tolerance.");
    return fmi2Discard;
}
#elif KIND == CONTROLLER
static fmi2Status advance(Instance *instance, double end) {
    State *s = &instance->s;
    const double last = end - same_instant(s);
    for (double instant = sampling_instant(s); instant < last; instant = sampling_instant(s)) {
        int output, state;
        if (!s->sampled) take_sample(s, instant);
        output = not_finite(outputs(s), N_OUTPUTS);
        state = not_finite(s->next, N_STATES);
        if (output >= 0 || state >= 0) {
            say(instance, fmi2Discard, "fmi2DoStep: %s is not finite at the sample t = %.17g s. Check inputs and parameters.",
                variables[output >= 0 ? OUTPUT_0 + output : STATE_0 + state].name, instant);
            s->time = fmax(s->time, instant);
            s->phase = STEP_FAILED;
            return fmi2Discard;
        }
        memcpy(states(s), s->next, sizeof(double) * N_STATES);
        s->sampled = 0;
        s->sample++;
    }
    s->time = end;
    return fmi2OK;
}
#else
static fmi2Status advance(Instance *instance, double end) {
    instance->s.time = end;
    return fmi2OK;
}
#endif

FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
    Instance *instance = c;
    State *s;
    fmi2Status status;
    (void)no_rollback;
    if (illegal(instance, STEP_COMPLETE, "fmi2DoStep")) return fmi2Error;
    s = &instance->s;
    if (!(isfinite(step) && step > 0.0)) {
        say(instance, fmi2Error, "fmi2DoStep: communication step size %g s. Give a positive, finite one.", step);
        return fail(instance);
    }
    if (!(fabs(time - s->time) <= 1e-6 * step + 8.0 * DBL_EPSILON * fabs(s->time))) {
        say(instance, fmi2Error, "fmi2DoStep: current communication point %.17g s, but the instance is at %.17g s. Continue "
            "where the last step ended, or set an FMU state.", time, s->time);
        return fail(instance);
    }
    if (time + step > s->stop + 1e-6 * step + 8.0 * DBL_EPSILON * fabs(s->stop)) {
        say(instance, fmi2Error, "fmi2DoStep: the step ends at %.17g s, behind the stop time %.17g s given in "
            "fmi2SetupExperiment. Set a later stop time or none.", time + step, s->stop);
        return fail(instance);
    }
    refresh_parameters(s);
    s->time = time;
    status = advance(instance, time + step);
#if KIND == CONTROLLER
    s->outputs_dirty = 0;
#else
    s->outputs_dirty = s->derivatives_dirty = 1;
#endif
    return status;
}

FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    Instance *instance = c;
    if (illegal(instance, ANY, "fmi2CancelStep")) return fmi2Error;
    say(instance, fmi2Error, "fmi2CancelStep: no step is in progress, fmi2DoStep returns when it is done.");
    return fail(instance);
}

FMI2_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *instance = c;
    if (illegal(instance, STEP_COMPLETE | STEP_FAILED | TERMINATED, "fmi2GetRealStatus") ||
        missing(instance, value, 1, "fmi2GetRealStatus"))
        return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) {
        say(instance, fmi2Discard, "fmi2GetRealStatus: only fmi2LastSuccessfulTime is known.");
        return fmi2Discard;
    }
    *value = instance->s.time;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *instance = c;
    if (illegal(instance, STEP_COMPLETE | STEP_FAILED | TERMINATED, "fmi2GetBooleanStatus") ||
        missing(instance, value, 1, "fmi2GetBooleanStatus"))
        return fmi2Error;
    if (kind != fmi2Terminated) {
        say(instance, fmi2Discard, "fmi2GetBooleanStatus: only fmi2Terminated is known.");
        return fmi2Discard;
    }
    *value = fmi2False; /* the component never asks to end the simulation */
    return fmi2OK;
}

static fmi2Status no_status(Instance *instance, const char *function) {
    if (illegal(instance, STEP_COMPLETE | STEP_FAILED | TERMINATED, function)) return fmi2Error;
    say(instance, fmi2Discard, "%s: fmi2DoStep never returns fmi2Pending, there is no such status.", function);
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
