/* One component as an importer drives it, whatever the version of FMI: life cycle, values, FMU state, derivatives, steps.

   model.c defines the sizes, the table of variables, the traced functions and their variants, and includes the interface
   (fmi2.c or fmi3.c), which includes this file. The interface defines
     Host        a plain struct with what it keeps of the importer,
     UNFINISHED  the status of a step that failed,
     type_names  its name of each type of variable,
     deliver     a function that hands a message to the importer.
   A variable's value reference is its index in State.v, whose order is parameters, inputs, states, outputs, derivatives,
   solver counters. State holds all that an instance remembers, so an FMU state is a copy of that struct. */
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "log.h"

#if KIND == PLANT
#include "integrator.c"
#else
#include "integrator.h"
#endif
#ifndef ELEMENTS /* an interface with arrays: elements of the variable with a value reference, 0 if there is none */
#define ELEMENTS(reference) 1
#endif

#define INPUT_0 N_PARAMETERS
#define STATE_0 (INPUT_0 + N_INPUTS)
#define OUTPUT_0 (STATE_0 + N_STATES)
#define DERIVATIVE_0 (OUTPUT_0 + N_OUTPUTS)
#define COUNTER_0 (DERIVATIVE_0 + N_CONTINUOUS)
#define N_KNOWN (N_CONTINUOUS + N_INPUTS)
#define N_UNKNOWN (N_CONTINUOUS + N_OUTPUTS)
#define AT_LEAST_1(n) ((n) > 0 ? (n) : 1)

/* A communication step as a fraction of the sampling time: ticks/per_sample; per_sample is 0 if there is none. */
typedef struct {
    double step; /* s */
    double ticks;
    double per_sample;
} Fraction;

/* Two counts of ticks that differ by less than this are equal. Counts are whole unless counting began between ticks. */
#define SAME_TICK 1e-6
/* Largest ticks of a step and of a sampling time: with more, a count is no longer exact to SAME_TICK, and any ratio of
   step and sampling time would pass as a fraction. */
#define MOST_TICKS 1e9
#define MOST_PER_SAMPLE 1e5

typedef struct {
    double v[N_VARIABLES];
    double next[AT_LEAST_1(N_STATES)]; /* controller: state of the next sample, valid while sampled */
    double c[AT_LEAST_1(N_CONSTANTS)]; /* derived from parameters */
    double start;                      /* s */
    double time;                       /* s, reached by the last step */
    double stop;                       /* s, infinite if not defined */
    double tolerance;                  /* of the experiment, 0 if not defined */
    long long steps;                   /* communication steps taken */
    long long sample;                  /* controller: index of the next sampling instant */
    double origin;                     /* controller: the importer's time at sample 0, s */
    double per_sample;                 /* controller: ticks that make T_s, 0 while time decides */
    double ahead;                      /* controller: ticks to the next sampling instant, valid if per_sample > 0 */
    Fraction fraction;                 /* controller: of the last step */
    Integrator integrator;
    int variant;
    int phase;
    int tolerance_set;    /* the parameter tolerance was set by the importer */
    int parameters_dirty; /* constants, variant and (before the first step) the initial state are to be computed */
    int outputs_dirty;
    int derivatives_dirty;
    int sampled; /* controller: outputs and next belong to the inputs at the coming sampling instant */
    int finite;  /* states and outputs were finite when they were last computed */
    int told[AT_LEAST_1(N_NOTES)]; /* each note is told once */
} State;

typedef struct Instance {
    State s;
    char *name;
    Host host;
    int model_exchange;
    unsigned categories; /* bit of each category that is logged */
} Instance;

/* ---- messages ---- */

static void deliver(const Instance *instance, int status, const char *category, char *text);

#if defined __clang__ || defined __GNUC__
__attribute__((format(printf, 3, 4)))
#endif
static void say(const Instance *instance, int status, const char *format, ...) {
    char text[1024];
    va_list arguments;
    const unsigned category = category_of(status);
    if (!is_wanted(instance->categories, category)) return;
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
    int k = 0;
    while (k < N_PHASES - 1 && !(phase & 1 << k)) k++;
    return phase_names[k];
}

/* Whether a call is not allowed in the present phase: then it is logged and the instance fails. */
static int illegal(Instance *instance, int phases, const char *function) {
    if (!instance) return 1;
    if (instance->s.phase & phases) return 0;
    say(instance, ERROR, SAY_NOT_ALLOWED, function, phase_name(instance->s.phase));
    fail(instance);
    return 1;
}

static int missing(Instance *instance, const void *pointer, size_t n, const char *function) {
    if (pointer || n == 0) return 0;
    say(instance, ERROR, SAY_NULL_ARGUMENT, function, (unsigned long)n);
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
    for (int i = 0; i < N_CHOICES; i++)
        index = index * choices[i].count + (int)p[choices[i].parameter] - choices[i].first;
#else
    (void)p;
#endif
    return index;
}

static void refresh_parameters(State *s) {
    if (!s->parameters_dirty) return;
    s->variant = variant_index(parameters(s));
    variant(s)->constants(s->time, NULL, NULL, parameters(s), NULL, s->c);
    if (s->phase & BEFORE) variant(s)->initial(s->start, NULL, NULL, parameters(s), NULL, states(s));
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

/* Index of the first value that is not finite, else -1. */
static int not_finite(const double *x, int n) {
    int bad = 0;
    for (int i = 0; i < n; i++) bad |= !(fabs(x[i]) <= DBL_MAX); /* no branch: almost always all are finite */
    if (!bad) return -1;
    for (int i = 0; i < n; i++)
        if (!isfinite(x[i])) return i;
    return -1;
}

#if KIND == CONTROLLER
#include "sampling.c"

static void take_sample(State *s, double t) {
    variant(s)->sample(t, states(s), inputs(s), parameters(s), s->c, outputs(s), s->next);
    s->finite = not_finite(outputs(s), N_OUTPUTS) < 0 && not_finite(s->next, N_STATES) < 0;
    s->sampled = 1;
    s->outputs_dirty = 0;
}
#endif

/* Update everything that an importer may read to the present inputs, parameters and time. */
static void refresh(State *s, int derivatives) {
    refresh_parameters(s);
    if (s->outputs_dirty) {
#if KIND == CONTROLLER
        if (at_sampling_instant(s)) take_sample(s, sample_time(s));
#else
        variant(s)->output(s->time, states(s), inputs(s), parameters(s), s->c, outputs(s));
        s->finite = not_finite(states(s), N_STATES + N_OUTPUTS) < 0;
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

/* ---- life cycle ---- */

static void set_start_values(State *s) {
    memset(s, 0, sizeof *s);
    for (int i = 0; i < N_VARIABLES; i++) s->v[i] = variables[i].start;
    s->phase = INSTANTIATED;
    s->stop = INFINITY;
    s->parameters_dirty = 1;
    touch(s);
}

/* Whether name and token allow an instance; if not, probe delivers the reason. */
static int acceptable(const Instance *probe, const char *name, const char *token, const char *function) {
    if (!name || !*name) {
        say(probe, ERROR, SAY_NO_NAME, function);
        return 0;
    }
    if (!token || strcmp(token, MODEL_GUID) != 0) {
        say(probe, ERROR, SAY_WRONG_TOKEN, function, token ? token : "", MODEL_GUID);
        return 0;
    }
    return 1;
}

/* A new instance, or NULL; then probe delivers the reason. */
static Instance *make_instance(const Instance *probe, const char *name, Host host, int model_exchange, int logging,
                               const char *function) {
    const size_t length = strlen(name) + 1;
    Instance *instance = (Instance *)calloc(1, sizeof *instance + length);
    if (!instance) {
        say(probe, ERROR, SAY_OUT_OF_MEMORY, function);
        return NULL;
    }
    instance->name = (char *)(instance + 1);
    memcpy(instance->name, name, length);
    instance->host = host;
    instance->model_exchange = model_exchange;
    instance->categories = logging ? EVERY_CATEGORY : ONLY_ERRORS;
    set_start_values(&instance->s);
    return instance;
}

/* The bits of named log categories, or 0 with a message. */
static unsigned named_categories(Instance *instance, size_t n, const char *const names[], const char *function) {
    unsigned categories = 0;
    for (size_t i = 0; i < n; i++) {
        const unsigned bit = category_bit(names[i]);
        if (!bit) {
            say(instance, ERROR, SAY_UNKNOWN_CATEGORY, function, names[i] ? names[i] : "");
            fail(instance);
            return 0;
        }
        categories |= bit;
    }
    return categories;
}

static int set_up(Instance *instance, int tolerance_defined, double tolerance, double start, int stop_defined,
                  double stop, const char *function) {
    if (!isfinite(start) || (stop_defined && !(isfinite(stop) && stop > start))) {
        say(instance, ERROR, SAY_WRONG_TIMES, function, start, stop_defined ? stop : start);
        return fail(instance);
    }
    if (tolerance_defined && !(isfinite(tolerance) && tolerance > 0.0)) {
        say(instance, ERROR, SAY_WRONG_TOLERANCE, function, tolerance);
        return fail(instance);
    }
    instance->s.start = instance->s.time = instance->s.origin = start;
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
        instance->s.v[PARAMETER_TOLERANCE] =
            fmin(fmax(instance->s.tolerance, variables[PARAMETER_TOLERANCE].min), variables[PARAMETER_TOLERANCE].max);
#endif
}

/* The first of states, outputs and derivatives that is not finite, else -1. */
static int not_finite_result(const State *s) {
    const int i = not_finite(s->v + STATE_0, N_STATES + N_OUTPUTS + N_CONTINUOUS);
    return i < 0 ? i : STATE_0 + i;
}

/* Log the notes, which tell what is legal but suspicious. They do not change the status of the call in progress. */
static void tell_notes(Instance *instance, const char *function) {
#if N_NOTES > 0
    State *s = &instance->s;
    double found[2 * N_NOTES]; /* value and limit of each */
    refresh_parameters(s);
    variant(s)->notes(s->time, states(s), NULL, parameters(s), NULL, found);
    for (int i = 0; i < N_NOTES; i++) {
        if (!(found[2 * i] > found[2 * i + 1]) || s->told[i]) continue;
        s->told[i] = 1;
        say(instance, WARNING, SAY_NOTE, function, note_texts[i].name, found[2 * i], note_texts[i].unit,
            note_texts[i].limit_name, found[2 * i + 1], note_texts[i].unit, note_texts[i].text);
    }
#else
    (void)instance;
    (void)function;
#endif
}

/* Check the rules between parameters and the initial values; then go to ``phase``. */
static int leave_initialization(Instance *instance, int phase, const char *function) {
    State *s = &instance->s;
    int i = broken_rule(s);
    if (i >= 0) {
        say(instance, ERROR, SAY_BROKEN_RULES, function, rule_texts[i]);
        return fail(instance);
    }
    refresh(s, 1);
    i = not_finite_result(s);
    if (i >= 0) {
        say(instance, ERROR, SAY_INITIAL_NOT_FINITE, function, variables[i].name);
        return fail(instance);
    }
    touch(s);
    s->phase = phase;
    tell_notes(instance, function);
    return OK;
}

static int terminate(Instance *instance, const char *function) {
    if (illegal(instance, MAY_TERMINATE, function)) return ERROR;
    tell_notes(instance, function);
    instance->s.phase = TERMINATED;
    return OK;
}

/* ---- values ---- */

static int unknown(Instance *instance, unsigned reference, int type, const char *function) {
    if (reference >= N_REFERENCES || ELEMENTS(reference) == 0) {
        say(instance, ERROR, SAY_UNKNOWN_REFERENCE, function, reference, MODEL_NAME, N_REFERENCES - 1);
        fail(instance);
        return 1;
    }
    if (variables[reference].type != type) {
        const char *name = type_names[variables[reference].type];
        say(instance, ERROR, SAY_WRONG_TYPE, function, variables[reference].name, reference, name, name, name);
        fail(instance);
        return 1;
    }
    return 0;
}

static int prepare_get(Instance *instance, const unsigned references[], size_t n, const void *values, int type,
                       const char *function) {
    int derivatives = 0;
    if (illegal(instance, MAY_GET, function) || missing(instance, references, n, function) ||
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
    const int before = instance->s.phase & BEFORE;
    double kept;
    if (variable->role != INPUT && variable->role != TUNABLE && !(variable->role == FIXED && before)) {
        if (variable->role == FIXED)
            say(instance, ERROR, SAY_FIXED, function, variable->name);
        else
            say(instance, ERROR, SAY_COMPUTED, function, variable->name);
        return fail(instance);
    }
    if (variable->role == TUNABLE && instance->s.phase == CONTINUOUS_TIME) {
        say(instance, ERROR, SAY_TUNABLE_IN_CONTINUOUS_TIME, function, variable->name);
        return fail(instance);
    }
    if (isfinite(value) && value >= variable->min && value <= variable->max) return OK;
    kept = instance->s.v[reference];
    if (!isfinite(value))
        say(instance, DISCARD, SAY_NOT_FINITE, function, variable->name, value, variable->unit, kept);
    else if (value < variable->min)
        say(instance, DISCARD, SAY_BELOW_MINIMUM, function, variable->name, value, variable->unit, variable->min,
            variable->unit, kept);
    else
        say(instance, DISCARD, SAY_ABOVE_MAXIMUM, function, variable->name, value, variable->unit, variable->max,
            variable->unit, kept);
    return DISCARD;
}

/* Whether the variable already has this value: some importers set all parameters again after initialization. They set
   the start value of the integrator's tolerance, too, even if they gave the experiment another tolerance, which stays. */
static int unchanged(const State *s, unsigned reference, double value) {
    const int role = variables[reference].role;
    if ((role != FIXED && role != TUNABLE) || s->phase & BEFORE) return 0;
#if KIND == PLANT
    if (reference == PARAMETER_TOLERANCE && !s->tolerance_set && value == variables[reference].start) return 1;
#endif
    return s->v[reference] == value;
}

static int set(Instance *instance, unsigned reference, double value, const char *function) {
    State *s = &instance->s;
    double previous;
    int status;
    if (unchanged(s, reference, value)) return OK;
    status = refused(instance, reference, value, function);
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
            say(instance, DISCARD, SAY_BREAKS_RULE, function, variables[reference].name, value,
                variables[reference].unit, rule_texts[rule], previous);
            s->v[reference] = previous;
            return DISCARD;
        }
    }
    return OK;
}

static int prepare_set(Instance *instance, const unsigned references[], size_t n, const void *values, int type,
                       const char *function) {
    if (illegal(instance, MAY_SET, function) || missing(instance, references, n, function) ||
        missing(instance, values, n, function))
        return 1;
    for (size_t i = 0; i < n; i++)
        if (unknown(instance, references[i], type, function)) return 1;
    return 0;
}

static int worse(int one, int other) { return one > other ? one : other; }

static int discard_result(Instance *instance, unsigned reference, const char *function) {
    say(instance, DISCARD, SAY_RESULT_NOT_FINITE, function, variables[reference].name, instance->s.time);
    return DISCARD;
}

/* ---- FMU state ---- */

#include "state.c"

/* ---- derivatives ---- */

/* Index of an unknown (state derivatives, then outputs) or of a known variable (continuous states, then inputs) among
   all of its kind; -1 with a message if the variable is neither. */
static int row_of(Instance *instance, unsigned reference, const char *function) {
    if (unknown(instance, reference, REAL, function)) return -1;
    if (variables[reference].role == DERIVATIVE) return (int)reference - DERIVATIVE_0;
    if (variables[reference].role == OUTPUT) return N_CONTINUOUS + (int)reference - OUTPUT_0;
    say(instance, ERROR, SAY_NO_UNKNOWN, function, variables[reference].name);
    fail(instance);
    return -1;
}

static int column_of(Instance *instance, unsigned reference, const char *function) {
    if (unknown(instance, reference, REAL, function)) return -1;
    if (variables[reference].role == INPUT) return N_CONTINUOUS + (int)reference - INPUT_0;
    if (variables[reference].role == STATE && (int)reference < STATE_0 + N_CONTINUOUS) return (int)reference - STATE_0;
    say(instance, ERROR, SAY_NO_KNOWN, function, variables[reference].name);
    fail(instance);
    return -1;
}

/* Derivatives of the N_UNKNOWN unknowns along a direction of the N_KNOWN knowns. */
static void differentiate(State *s, const double *direction, double *derivatives) {
    refresh_parameters(s);
#if KIND == CONTROLLER
    variant(s)->directional(sample_time(s), states(s), inputs(s), parameters(s), s->c, direction, derivatives);
#else
    variant(s)->directional(s->time, states(s), inputs(s), parameters(s), s->c, direction, derivatives);
#endif
}

static int directional_derivative(Instance *instance, const unsigned unknowns[], size_t n_unknown,
                                  const unsigned knowns[], size_t n_known, const double seed[], double result[],
                                  const char *function) {
    double direction[AT_LEAST_1(N_KNOWN)] = {0.0};
    double derivatives[AT_LEAST_1(N_UNKNOWN)] = {0.0};
    if (illegal(instance, MAY_DIFFERENTIATE, function) || missing(instance, unknowns, n_unknown, function) ||
        missing(instance, knowns, n_known, function) || missing(instance, seed, n_known, function) ||
        missing(instance, result, n_unknown, function))
        return ERROR;
    for (size_t i = 0; i < n_known; i++) {
        const int column = column_of(instance, knowns[i], function);
        if (column < 0) return ERROR;
        direction[column] += seed[i];
    }
    differentiate(&instance->s, direction, derivatives);
    for (size_t i = 0; i < n_unknown; i++) {
        const int row = row_of(instance, unknowns[i], function);
        if (row < 0) return ERROR;
        result[i] = derivatives[row];
        if (!isfinite(result[i])) return discard_result(instance, unknowns[i], function);
    }
    return OK;
}

/* ---- model exchange ---- */

/* Whether an array of continuous states or event indicators has the wrong length or is NULL. */
static int wrong_length(Instance *instance, const void *values, size_t n, size_t expected, const char *function) {
    if (n == expected) return missing(instance, values, n, function);
    say(instance, ERROR, SAY_WRONG_LENGTH, function, (unsigned long)n, MODEL_NAME, (unsigned long)expected);
    fail(instance);
    return 1;
}

static int enter_continuous_time(Instance *instance, const char *function) {
    if (illegal(instance, MAY_ENTER_CONTINUOUS_TIME, function)) return ERROR;
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
    if (illegal(instance, MAY_SET_CONTINUOUS, function)) return ERROR;
    if (!isfinite(time)) {
        say(instance, ERROR, SAY_TIME_NOT_FINITE, function, time);
        return fail(instance);
    }
    instance->s.time = time;
    touch(&instance->s);
    return OK;
}

static int set_continuous_states(Instance *instance, const double x[], size_t n, const char *function) {
    int i;
    if (illegal(instance, MAY_SET_CONTINUOUS, function) || wrong_length(instance, x, n, N_CONTINUOUS, function))
        return ERROR;
    i = not_finite(x, N_CONTINUOUS);
    if (i >= 0) {
        say(instance, DISCARD, SAY_STATES_NOT_FINITE, function, variables[STATE_0 + i].name, x[i]);
        return DISCARD;
    }
    for (i = 0; i < N_CONTINUOUS; i++) states(&instance->s)[i] = x[i];
    touch(&instance->s);
    return OK;
}

static int continuous_states(Instance *instance, double x[], size_t n, const char *function) {
    if (illegal(instance, MAY_GET_CONTINUOUS, function) || wrong_length(instance, x, n, N_CONTINUOUS, function))
        return ERROR;
    refresh_parameters(&instance->s);
    for (int i = 0; i < N_CONTINUOUS; i++) x[i] = states(&instance->s)[i];
    return OK;
}

static int state_derivatives(Instance *instance, double derivatives[], size_t n, const char *function) {
    State *s;
    int i;
    if (illegal(instance, MAY_GET_CONTINUOUS, function) ||
        wrong_length(instance, derivatives, n, N_CONTINUOUS, function))
        return ERROR;
    s = &instance->s;
    s->integrator.derivatives += s->derivatives_dirty != 0;
    refresh(s, 1);
    for (i = 0; i < N_CONTINUOUS; i++) derivatives[i] = s->v[DERIVATIVE_0 + i];
    i = not_finite(derivatives, N_CONTINUOUS);
    if (i < 0) return OK;
    say(instance, DISCARD, SAY_DERIVATIVE_NOT_FINITE, function, variables[DERIVATIVE_0 + i].name, s->time);
    return DISCARD;
}

/* There are no event indicators. */
static int event_indicators(Instance *instance, const double indicators[], size_t n, const char *function) {
    return illegal(instance, MAY_GET_CONTINUOUS, function) || wrong_length(instance, indicators, n, 0, function) ? ERROR
                                                                                                                 : OK;
}

static int state_nominals(Instance *instance, double values[], size_t n, const char *function) {
    if (illegal(instance, MAY_GET_NOMINALS, function) || wrong_length(instance, values, n, N_CONTINUOUS, function))
        return ERROR;
#if KIND == PLANT
    for (int i = 0; i < N_CONTINUOUS; i++) values[i] = nominals[i];
#endif
    return OK;
}

/* ---- stepping ---- */

#if KIND == PLANT
static int advance(Instance *instance, double step, double end, const char *function) {
    /* in the order of the codes of integrate() */
    static const char *const reasons[] = {"", REASON_STEP_TOO_SMALL, REASON_TOO_MANY_STEPS, REASON_NOT_FINITE};
    State *s = &instance->s;
    Problem problem = {variant(s)->derivative,
                       variant(s)->jacobian,
                       N_STATES > N_CONTINUOUS ? variant(s)->update : NULL,
                       inputs(s),
                       parameters(s),
                       s->c,
                       nominals,
                       s->v[PARAMETER_TOLERANCE],
                       MAX_ATTEMPTS};
    const int code = integrate(&problem, &s->integrator, s->time, end, states(s));
    (void)step;
    if (code == INTEGRATE_OK) {
        s->time = end;
        return OK;
    }
    s->time = s->integrator.time;
    s->phase = STEP_FAILED;
    say(instance, UNFINISHED, SAY_STOPPED, function, problem.tolerance, s->time,
        s->integrator.failing >= 0 ? variables[STATE_0 + s->integrator.failing].name : "no single state",
        reasons[code]);
    return UNFINISHED;
}
#elif KIND == CONTROLLER
static int advance(Instance *instance, double step, double end, const char *function) {
    State *s = &instance->s;
    double n;
    count_ticks(s, step, end);
    n = samples_due(s, end);
    if (n > MAX_SAMPLES) {
        say(instance, UNFINISHED, SAY_TOO_MANY_SAMPLES, function, step, n, sampling_time(s), MAX_SAMPLES);
        s->phase = STEP_FAILED;
        return UNFINISHED;
    }
    for (long left = (long)n; left > 0; left--) {
        if (!s->sampled) take_sample(s, sample_time(s));
        if (!s->finite) {
            const int output = not_finite(outputs(s), N_OUTPUTS);
            const int reference = output >= 0 ? OUTPUT_0 + output : STATE_0 + not_finite(s->next, N_STATES);
            say(instance, UNFINISHED, SAY_SAMPLE_NOT_FINITE, function, variables[reference].name, sampling_instant(s));
            s->time = fmax(s->time, sampling_instant(s));
            s->phase = STEP_FAILED;
            return UNFINISHED;
        }
        memcpy(states(s), s->next, sizeof(double) * N_STATES);
        s->sampled = 0;
        s->sample++;
    }
    if (s->per_sample > 0.0) s->ahead += n * s->per_sample - s->fraction.ticks;
    s->time = end;
    return OK;
}
#else
static int advance(Instance *instance, double step, double end, const char *function) {
    (void)step;
    (void)function;
    instance->s.time = end;
    return OK;
}
#endif

/* Whether a step from ``time`` may be taken now. */
static int steppable(Instance *instance, double time, double step, const char *function) {
    const State *s = instance ? &instance->s : NULL;
    const double end = time + step;
    if (illegal(instance, MAY_STEP, function)) return 0;
    if (!(isfinite(step) && step > 0.0 && !isinf(end))) {
        say(instance, ERROR, SAY_STEP_SIZE, function, step);
        fail(instance);
        return 0;
    }
    if (!(fabs(time - s->time) <= 1e-6 * step + 8.0 * DBL_EPSILON * fabs(s->time))) {
        say(instance, ERROR, SAY_WRONG_POINT, function, time, s->time);
        fail(instance);
        return 0;
    }
    /* an importer may add up its time, t += h: then each step adds a rounding error */
    if (end > s->stop && end > s->stop + 1e-6 * step + (8.0 + (double)s->steps) * DBL_EPSILON * fabs(s->stop)) {
        say(instance, ERROR, SAY_BEHIND_STOP, function, end, s->stop);
        fail(instance);
        return 0;
    }
    return 1;
}

static int step_to(Instance *instance, double time, double step, const char *function) {
    State *s = &instance->s;
    int status;
    refresh_parameters(s);
    s->time = time;
    s->steps++;
    status = advance(instance, step, time + step, function);
#if KIND == CONTROLLER
    s->outputs_dirty = 0;
#else
    s->outputs_dirty = s->derivatives_dirty = 1;
    if (status == OK) {
        refresh(s, 0);
        if (!s->finite) {
            say(instance, UNFINISHED, SAY_RESULT_NOT_FINITE, function, variables[not_finite_result(s)].name, s->time);
            s->time = time; /* end of the last successful step */
            s->phase = STEP_FAILED;
            return UNFINISHED;
        }
    }
#endif
    return status;
}
