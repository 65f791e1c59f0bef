/* One component as an importer drives it, whatever the version of FMI: life cycle, values, FMU state, derivatives, steps.

   model.c defines the sizes, the table of variables, the traced functions and their variants, and includes the interface
   (fmi2.c or fmi3.c), which includes this file. The interface defines
     Host      what it keeps of the importer, a plain struct,
     FMI       the beginning of its function names, STANDARD its name, TOKEN its word for MODEL_GUID,
     UNFINISHED  the status of a step that failed,
     type_names  its name of each type of variable,
     deliver   which hands a message to the importer.
   A variable's value reference is its index in State.v, whose order is parameters, inputs, states, outputs, derivatives,
   solver counters. All that an instance remembers is in State, so copying an FMU state is copying that struct. */
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if KIND == PLANT
#include "integrator.c"
#else
#include "integrator.h"
#endif
#ifndef ELEMENTS /* an interface with arrays: elements of the variable with a value reference, 0 if there is none */
#define ELEMENTS(reference) 1
#endif
#ifndef GETTABLE
#define GETTABLE READABLE
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
    double tolerance;                       /* of the experiment, 0 if not defined */
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
    Host host;
    int model_exchange;
    unsigned categories; /* bit of each category that is logged */
} Instance;

/* Status codes, those of FMI. */
enum { OK, WARNING, DISCARD, ERROR };

static const char *const category_names[] = {"logStatusWarning", "logStatusDiscard", "logStatusError", "logAll"};
enum { LOG_WARNING, LOG_DISCARD, LOG_ERROR, LOG_ALL, N_CATEGORIES };
#define EVERY_CATEGORY ~0u

/* ---- messages ---- */

static void deliver(const Instance *instance, int status, const char *category, char *text);

static void say(const Instance *instance, int status, const char *format, ...) {
    char text[1024];
    va_list arguments;
    const unsigned category = status == WARNING ? LOG_WARNING : status == DISCARD ? LOG_DISCARD : LOG_ERROR;
    if (!(instance->categories & (1u << category | 1u << LOG_ALL))) return;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    deliver(instance, status, category_names[category], text);
}

static int fail(Instance *instance) {
    instance->s.phase = FAILED;
    return ERROR;
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
    say(instance, ERROR, "%s: not allowed in state '%s'. Follow the " STANDARD " calling sequence, or reset the instance.",
        function, phase_name(instance->s.phase));
    fail(instance);
    return 1;
}

static int missing(Instance *instance, const void *pointer, size_t n, const char *function) {
    if (pointer || n == 0) return 0;
    say(instance, ERROR, "%s: an argument is NULL. Pass an array of %lu elements.", function, (unsigned long)n);
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
/* The next sampling instant, or the one so many behind it. */
static double instant_ahead(const State *s, unsigned n) { return s->start + (double)(s->sample + n) * sampling_time(s); }
static double sampling_instant(const State *s) { return instant_ahead(s, 0); }
/* Two times are one sampling instant if they differ by rounding only. */
static double same_instant(const State *s) {
    const double rounding = 1e-6 * sampling_time(s) + 8.0 * DBL_EPSILON * fabs(s->time);
    return rounding < 0.25 * sampling_time(s) ? rounding : 0.25 * sampling_time(s);
}

static int at_sampling_instant(const State *s) { return fabs(s->time - sampling_instant(s)) <= same_instant(s); }

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
        if (at_sampling_instant(s)) take_sample(s, sampling_instant(s));
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

/* Whether an instance may be made of name and token; if not it is said through probe. */
static int acceptable(const Instance *probe, const char *name, const char *token, const char *function) {
    if (!name || !*name) {
        say(probe, ERROR, "%s: the instance name is empty. Give one.", function);
        return 0;
    }
    if (!token || strcmp(token, MODEL_GUID) != 0) {
        say(probe, ERROR, "%s: " TOKEN " is '%s', this binary has '%s'. Use the modelDescription.xml of this FMU.",
            function, token ? token : "", MODEL_GUID);
        return 0;
    }
    return 1;
}

/* Bytes of an instance of that name, and the instance made in as many bytes. */
static size_t instance_size(const char *name) { return sizeof(Instance) + strlen(name) + 1; }

static Instance *make_instance(void *memory, const char *name, Host host, int model_exchange, int logging) {
    Instance *instance = memory;
    memset(instance, 0, sizeof *instance);
    instance->name = (char *)(instance + 1);
    strcpy(instance->name, name);
    instance->host = host;
    instance->model_exchange = model_exchange;
    instance->categories = logging ? EVERY_CATEGORY : 0;
    set_start_values(&instance->s);
    return instance;
}

/* The bits of named log categories, or 0 with a message. */
static unsigned named_categories(Instance *instance, size_t n, const char *const names[], const char *function) {
    unsigned categories = 0;
    for (size_t i = 0; i < n; i++) {
        unsigned k = 0;
        while (k < N_CATEGORIES && (!names[i] || strcmp(names[i], category_names[k]) != 0)) k++;
        if (k == N_CATEGORIES) {
            say(instance, ERROR, "%s: unknown category '%s'. Use those of modelDescription.xml.", function,
                names[i] ? names[i] : "");
            fail(instance);
            return 0;
        }
        categories |= 1u << k;
    }
    return categories;
}

static int set_up(Instance *instance, int tolerance_defined, double tolerance, double start, int stop_defined, double stop,
                  const char *function) {
    if (!isfinite(start) || (stop_defined && !(isfinite(stop) && stop > start))) {
        say(instance, ERROR, "%s: start time %g s, stop time %g s: give finite times, stop after start.", function, start,
            stop_defined ? stop : start);
        return fail(instance);
    }
    if (tolerance_defined && !(isfinite(tolerance) && tolerance > 0.0)) {
        say(instance, ERROR, "%s: tolerance %g: give a positive number.", function, tolerance);
        return fail(instance);
    }
    instance->s.start = instance->s.time = start;
    instance->s.stop = stop_defined ? stop : INFINITY;
    instance->s.tolerance = tolerance_defined ? tolerance : 0.0;
    instance->s.parameters_dirty = 1;
    touch(&instance->s);
    return OK;
}

static void enter_initialization(Instance *instance) {
    instance->s.phase = INITIALIZATION;
#if KIND == PLANT
    if (instance->s.tolerance > 0.0 && !instance->s.tolerance_set)
        instance->s.v[PARAMETER_TOLERANCE] = fmin(fmax(instance->s.tolerance, variables[PARAMETER_TOLERANCE].min),
                                                  variables[PARAMETER_TOLERANCE].max);
#endif
}

/* Check what parameters must hold together, and the initial state; then go to ``phase``. */
static int leave_initialization(Instance *instance, int phase, const char *function) {
    State *s = &instance->s;
    int i = broken_rule(s);
    if (i >= 0) {
        say(instance, ERROR, "%s: %s", function, rule_texts[i]);
        return fail(instance);
    }
    refresh_parameters(s);
    i = not_finite(states(s), N_STATES);
    if (i >= 0) {
        say(instance, ERROR, "%s: the initial %s is not finite. Check the parameters.", function,
            variables[STATE_0 + i].name);
        return fail(instance);
    }
    touch(s);
    s->phase = phase;
    return OK;
}

/* ---- values ---- */

static int unknown(Instance *instance, unsigned reference, int type, const char *function) {
    if (reference >= N_REFERENCES || ELEMENTS(reference) == 0) {
        say(instance, ERROR, "%s: unknown value reference %u. " MODEL_NAME " has 0 to %d.", function, reference,
            N_REFERENCES - 1);
        fail(instance);
        return 1;
    }
    if (variables[reference].type != type) {
        const char *name = type_names[variables[reference].type];
        say(instance, ERROR, "%s: %s (value reference %u) is of type %s. Use " FMI "Get%s or " FMI "Set%s.", function,
            variables[reference].name, reference, name, name, name);
        fail(instance);
        return 1;
    }
    return 0;
}

static int prepare_get(Instance *instance, const unsigned references[], size_t n, const void *values, int type,
                       const char *function) {
    int derivatives = 0;
    if (illegal(instance, GETTABLE, function) || missing(instance, references, n, function) ||
        missing(instance, values, n, function))
        return 1;
    for (size_t i = 0; i < n; i++) {
        if (unknown(instance, references[i], type, function)) return 1;
        derivatives |= variables[references[i]].role == DERIVATIVE;
    }
    if (instance->s.phase & EVALUATED) refresh(&instance->s, derivatives);
    return 0;
}

static unsigned long long counter(const State *s, size_t index) {
    const unsigned long long counts[] = {s->integrator.steps, s->integrator.rejected, s->integrator.derivatives,
                                         s->integrator.jacobians, s->integrator.decompositions};
    return counts[index];
}

/* Whether a variable may take a value now: OK, or the status to return, with a message. */
static int refused(Instance *instance, unsigned reference, double value, const char *function) {
    const Variable *variable = &variables[reference];
    const int before = instance->s.phase & (INSTANTIATED | INITIALIZATION);
    if (variable->role != INPUT && variable->role != TUNABLE && !(variable->role == FIXED && before)) {
        say(instance, ERROR, "%s: %s %s.", function, variable->name,
            variable->role == FIXED ? "is a fixed parameter. Set it before initialization ends"
                                    : "is computed by the FMU. Set inputs and parameters only");
        return fail(instance);
    }
    if (variable->role == TUNABLE && instance->s.phase == CONTINUOUS_TIME) {
        say(instance, ERROR, "%s: %s is a tunable parameter. Set it in event mode.", function, variable->name);
        return fail(instance);
    }
    if (isfinite(value) && value >= variable->min && value <= variable->max) return OK;
    if (!isfinite(value))
        say(instance, DISCARD, "%s: %s = %g %s: must be finite. The previous value %g is kept.", function,
            variable->name, value, variable->unit, instance->s.v[reference]);
    else
        say(instance, DISCARD, "%s: %s = %.17g %s: %s %.17g %s. The previous value %g is kept.", function,
            variable->name, value, variable->unit, value < variable->min ? "below its minimum" : "above its maximum",
            value < variable->min ? variable->min : variable->max, variable->unit, instance->s.v[reference]);
    return DISCARD;
}

static int set(Instance *instance, unsigned reference, double value, const char *function) {
    State *s = &instance->s;
    const int status = refused(instance, reference, value, function);
    double previous;
    if (status != OK) return status;
    previous = s->v[reference];
    s->v[reference] = value;
    touch(s);
    if (variables[reference].role == INPUT) return OK;
    s->parameters_dirty = 1;
#if KIND == PLANT
    if (reference == PARAMETER_TOLERANCE) s->tolerance_set = 1;
#endif
    if (s->phase == STEP_COMPLETE || s->phase == EVENT_MODE) {
        const int rule = broken_rule(s);
        if (rule >= 0) {
            say(instance, DISCARD, "%s: %s = %g %s: %s The previous value %g is kept.", function,
                variables[reference].name, value, variables[reference].unit, rule_texts[rule], previous);
            s->v[reference] = previous;
            return DISCARD;
        }
    }
    return OK;
}

static int prepare_set(Instance *instance, const unsigned references[], size_t n, const void *values, int type,
                       const char *function) {
    if (illegal(instance, WRITABLE, function) || missing(instance, references, n, function) ||
        missing(instance, values, n, function))
        return 1;
    for (size_t i = 0; i < n; i++)
        if (unknown(instance, references[i], type, function)) return 1;
    return 0;
}

static int worse(int one, int other) { return one > other ? one : other; }

/* ---- FMU state ---- */

typedef struct {
    char guid[40];
    unsigned long long size;
    int model_exchange;
    State s;
} Saved;

/* Memory for a state where *saved points to none yet. */
static Saved *memory_for(Instance *instance, void **saved, const char *function) {
    Saved *copy = *saved ? *saved : calloc(1, sizeof *copy);
    if (!copy) {
        say(instance, ERROR, "%s: out of memory.", function);
        fail(instance);
    }
    return copy;
}

static int save_state(Instance *instance, void **saved, const char *function) {
    Saved *copy;
    if (illegal(instance, ANY, function) || missing(instance, saved, 1, function)) return ERROR;
    copy = memory_for(instance, saved, function);
    if (!copy) return ERROR;
    memset(copy, 0, sizeof *copy);
    strncpy(copy->guid, MODEL_GUID, sizeof copy->guid - 1);
    copy->size = sizeof *copy;
    copy->model_exchange = instance->model_exchange;
    memcpy(&copy->s, &instance->s, sizeof copy->s);
    *saved = copy;
    return OK;
}

static int restore_state(Instance *instance, const Saved *saved, const char *function) {
    if (illegal(instance, ANY, function) || missing(instance, saved, 1, function)) return ERROR;
    if (saved->model_exchange != instance->model_exchange) {
        say(instance, ERROR, "%s: the state is that of an instance for %s. Use one of the same kind.", function,
            instance->model_exchange ? "co-simulation" : "model exchange");
        return fail(instance);
    }
    memcpy(&instance->s, &saved->s, sizeof instance->s);
    return OK;
}

static int free_state(Instance *instance, void **saved, const char *function) {
    if (illegal(instance, ANY, function)) return ERROR;
    if (!saved) return OK;
    free(*saved);
    *saved = NULL;
    return OK;
}

static int state_size(Instance *instance, const void *saved, size_t *size, const char *function) {
    if (illegal(instance, ANY, function) || missing(instance, saved, 1, function) || missing(instance, size, 1, function))
        return ERROR;
    *size = sizeof(Saved);
    return OK;
}

static int serialize_state(Instance *instance, const void *saved, void *bytes, size_t size, const char *function) {
    if (illegal(instance, ANY, function) || missing(instance, saved, 1, function) ||
        missing(instance, bytes, size, function))
        return ERROR;
    if (size < sizeof(Saved)) {
        say(instance, ERROR, "%s: %lu bytes are too few. Give %lu, as the function for their number says.", function,
            (unsigned long)size, (unsigned long)sizeof(Saved));
        return fail(instance);
    }
    memcpy(bytes, saved, sizeof(Saved));
    return OK;
}

static int deserialize_state(Instance *instance, const void *bytes, size_t size, void **saved, const char *function) {
    const char *content = bytes;
    Saved *copy;
    if (illegal(instance, ANY, function) || missing(instance, bytes, size, function) || missing(instance, saved, 1, function))
        return ERROR;
    if (size < sizeof(Saved) || strncmp(content, MODEL_GUID, sizeof((Saved *)0)->guid) != 0 ||
        memcmp(content + offsetof(Saved, size), &(unsigned long long){sizeof(Saved)}, sizeof(unsigned long long)) != 0) {
        say(instance, ERROR, "%s: these %lu bytes are no state of this FMU. Pass what the same FMU on the same platform "
            "serialized.", function, (unsigned long)size);
        return fail(instance);
    }
    copy = memory_for(instance, saved, function);
    if (!copy) return ERROR;
    memcpy(copy, bytes, sizeof *copy);
    *saved = copy;
    return OK;
}

/* ---- derivatives ---- */

/* Place of an unknown (state derivatives, then outputs) or a known (continuous states, then inputs) among the partial
   derivatives, else -1 with a message. */
static int row_of(Instance *instance, unsigned reference, const char *function) {
    if (unknown(instance, reference, REAL, function)) return -1;
    if (variables[reference].role == DERIVATIVE) return (int)reference - DERIVATIVE_0;
    if (variables[reference].role == OUTPUT) return N_CONTINUOUS + (int)reference - OUTPUT_0;
    say(instance, ERROR, "%s: %s is no unknown variable. Differentiate outputs and state derivatives.", function,
        variables[reference].name);
    fail(instance);
    return -1;
}

static int column_of(Instance *instance, unsigned reference, const char *function) {
    if (unknown(instance, reference, REAL, function)) return -1;
    if (variables[reference].role == INPUT) return N_CONTINUOUS + (int)reference - INPUT_0;
    if (variables[reference].role == STATE && reference - STATE_0 < N_CONTINUOUS) return (int)reference - STATE_0;
    say(instance, ERROR, "%s: %s is no known variable. Differentiate with respect to inputs and continuous states.",
        function, variables[reference].name);
    fail(instance);
    return -1;
}

/* Matrix of N_CONTINUOUS + N_OUTPUTS rows and N_KNOWN columns. */
static void partial_derivatives(State *s, double *partials) {
    refresh_parameters(s);
#if KIND == CONTROLLER
    variant(s)->partials(sampling_instant(s), states(s), inputs(s), parameters(s), s->c, partials);
#else
    variant(s)->partials(s->time, states(s), inputs(s), parameters(s), s->c, partials);
#endif
}

static int directional_derivative(Instance *instance, const unsigned unknowns[], size_t n_unknown, const unsigned knowns[],
                                  size_t n_known, const double seed[], double result[], const char *function) {
    double partials[AT_LEAST_1((N_CONTINUOUS + N_OUTPUTS) * N_KNOWN)];
    double direction[AT_LEAST_1(N_KNOWN)] = {0.0};
    if (illegal(instance, READABLE, function) || missing(instance, unknowns, n_unknown, function) ||
        missing(instance, knowns, n_known, function) || missing(instance, seed, n_known, function) ||
        missing(instance, result, n_unknown, function))
        return ERROR;
    for (size_t i = 0; i < n_known; i++) {
        const int column = column_of(instance, knowns[i], function);
        if (column < 0) return ERROR;
        direction[column] += seed[i];
    }
    partial_derivatives(&instance->s, partials);
    for (size_t i = 0; i < n_unknown; i++) {
        const int row = row_of(instance, unknowns[i], function);
        if (row < 0) return ERROR;
        result[i] = 0.0;
        for (size_t k = 0; k < N_KNOWN; k++) result[i] += partials[(size_t)row * N_KNOWN + k] * direction[k];
    }
    return OK;
}

/* ---- model exchange ---- */

#define MODES_READ (INITIALIZATION | EXCHANGE | TERMINATED | FAILED)

/* Whether an array of continuous states or event indicators has the wrong length or is NULL. */
static int wrong_length(Instance *instance, const void *values, size_t n, size_t expected, const char *function) {
    if (n == expected) return missing(instance, values, n, function);
    say(instance, ERROR, "%s: an array of %lu elements, but " MODEL_NAME " has %lu. Pass one of that length.", function,
        (unsigned long)n, (unsigned long)expected);
    fail(instance);
    return 1;
}

static int enter_continuous_time(Instance *instance, const char *function) {
    if (illegal(instance, EVENT_MODE, function)) return ERROR;
    refresh_parameters(&instance->s);
    instance->s.phase = CONTINUOUS_TIME;
    return OK;
}

/* Discrete states follow accepted steps; there are no other events. */
static int completed_step(Instance *instance) {
    instance->s.integrator.steps++;
#if KIND == PLANT
    if (N_STATES > N_CONTINUOUS) {
        State *s = &instance->s;
        variant(s)->update(s->time, states(s), inputs(s), parameters(s), s->c);
        touch(s);
    }
#endif
    return OK;
}

static int set_time(Instance *instance, double time, const char *function) {
    if (illegal(instance, EXCHANGE, function)) return ERROR;
    if (!isfinite(time)) {
        say(instance, ERROR, "%s: %g s. Give a finite time.", function, time);
        return fail(instance);
    }
    instance->s.time = time;
    touch(&instance->s);
    return OK;
}

static int set_continuous_states(Instance *instance, const double x[], size_t n, const char *function) {
    int i;
    if (illegal(instance, EXCHANGE, function) || wrong_length(instance, x, n, N_CONTINUOUS, function)) return ERROR;
    i = not_finite(x, N_CONTINUOUS);
    if (i >= 0) {
        say(instance, DISCARD, "%s: %s = %g: must be finite. The previous states are kept.", function,
            variables[STATE_0 + i].name, x[i]);
        return DISCARD;
    }
    for (i = 0; i < N_CONTINUOUS; i++) states(&instance->s)[i] = x[i];
    touch(&instance->s);
    return OK;
}

static int continuous_states(Instance *instance, double x[], size_t n, const char *function) {
    if (illegal(instance, MODES_READ, function) || wrong_length(instance, x, n, N_CONTINUOUS, function)) return ERROR;
    refresh_parameters(&instance->s);
    for (int i = 0; i < N_CONTINUOUS; i++) x[i] = states(&instance->s)[i];
    return OK;
}

static int state_derivatives(Instance *instance, double derivatives[], size_t n, const char *function) {
    State *s;
    int i;
    if (illegal(instance, MODES_READ, function) || wrong_length(instance, derivatives, n, N_CONTINUOUS, function)) return ERROR;
    s = &instance->s;
    s->integrator.derivatives += s->derivatives_dirty != 0;
    refresh(s, 1);
    for (i = 0; i < N_CONTINUOUS; i++) derivatives[i] = s->v[DERIVATIVE_0 + i];
    i = not_finite(derivatives, N_CONTINUOUS);
    if (i < 0) return OK;
    say(instance, DISCARD, "%s: %s is not finite at t = %.17g s. Check inputs and states, or take a smaller step.", function,
        variables[DERIVATIVE_0 + i].name, s->time);
    return DISCARD;
}

/* There are none. */
static int event_indicators(Instance *instance, const double indicators[], size_t n, const char *function) {
    return illegal(instance, MODES_READ, function) || wrong_length(instance, indicators, n, 0, function) ? ERROR : OK;
}

static int state_nominals(Instance *instance, double values[], size_t n, const char *function) {
    if (illegal(instance, INSTANTIATED | MODES_READ, function) || wrong_length(instance, values, n, N_CONTINUOUS, function))
        return ERROR;
#if KIND == PLANT
    for (int i = 0; i < N_CONTINUOUS; i++) values[i] = nominals[i];
#endif
    return OK;
}

/* ---- stepping ---- */

#if KIND == PLANT
static int advance(Instance *instance, double end, const char *function) {
    State *s = &instance->s;
    Problem problem = {variant(s)->derivative, variant(s)->jacobian, N_STATES > N_CONTINUOUS ? variant(s)->update : NULL,
                       inputs(s), parameters(s), s->c, nominals, s->v[PARAMETER_TOLERANCE], MAX_STEPS};
    const int code = integrate(&problem, &s->integrator, s->time, end, states(s));
    if (code == INTEGRATE_OK) {
        s->time = end;
        return OK;
    }
    s->time = s->integrator.time;
    s->phase = STEP_FAILED;
    say(instance, UNFINISHED, "%s: integration stopped at t = %.17g s, %s (%s). %s", function, s->time,
        code == INTEGRATE_TOO_MANY_STEPS ? "too many steps"
        : code == INTEGRATE_NOT_FINITE   ? "a derivative is not finite"
                                         : "the step size became too small",
        s->integrator.failing >= 0 ? variables[STATE_0 + s->integrator.failing].name : "no single state",
        "Check inputs and parameters, or enlarge the tolerance.");
    return UNFINISHED;
}
#elif KIND == CONTROLLER
static int advance(Instance *instance, double end, const char *function) {
    State *s = &instance->s;
    const double last = end - same_instant(s);
    for (double instant = sampling_instant(s); instant < last; instant = sampling_instant(s)) {
        int output, state;
        if (!s->sampled) take_sample(s, instant);
        output = not_finite(outputs(s), N_OUTPUTS);
        state = not_finite(s->next, N_STATES);
        if (output >= 0 || state >= 0) {
            say(instance, UNFINISHED, "%s: %s is not finite at the sample t = %.17g s. Check inputs and parameters.", function,
                variables[output >= 0 ? OUTPUT_0 + output : STATE_0 + state].name, instant);
            s->time = fmax(s->time, instant);
            s->phase = STEP_FAILED;
            return UNFINISHED;
        }
        memcpy(states(s), s->next, sizeof(double) * N_STATES);
        s->sampled = 0;
        s->sample++;
    }
    s->time = end;
    return OK;
}
#else
static int advance(Instance *instance, double end, const char *function) {
    (void)function;
    instance->s.time = end;
    return OK;
}
#endif

/* Whether a step may be taken now from ``time`` on. */
static int steppable(Instance *instance, double time, double step, const char *function) {
    const State *s = instance ? &instance->s : NULL;
    if (illegal(instance, STEP_COMPLETE, function)) return 0;
    if (!(isfinite(step) && step > 0.0)) {
        say(instance, ERROR, "%s: communication step size %g s. Give a positive, finite one.", function, step);
        fail(instance);
        return 0;
    }
    if (!(fabs(time - s->time) <= 1e-6 * step + 8.0 * DBL_EPSILON * fabs(s->time))) {
        say(instance, ERROR, "%s: current communication point %.17g s, but the instance is at %.17g s. Continue "
            "where the last step ended, or set an FMU state.", function, time, s->time);
        fail(instance);
        return 0;
    }
    if (time + step > s->stop + 1e-6 * step + 8.0 * DBL_EPSILON * fabs(s->stop)) {
        say(instance, ERROR, "%s: the step ends at %.17g s, behind the stop time %.17g s given before. Set a later stop time "
            "or none.", function, time + step, s->stop);
        fail(instance);
        return 0;
    }
    return 1;
}

static int step_to(Instance *instance, double time, double end, const char *function) {
    State *s = &instance->s;
    int status;
    refresh_parameters(s);
    s->time = time;
    status = advance(instance, end, function);
#if KIND == CONTROLLER
    s->outputs_dirty = 0;
#else
    s->outputs_dirty = s->derivatives_dirty = 1;
#endif
    return status;
}
