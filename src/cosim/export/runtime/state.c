/* Functions that make, restore, serialize and deserialize FMU states; included by core.c. */

/* An FMU state as the importer gets it, also in bytes. The layout is that of this binary; the guid shows whether a
   state comes from another one. */
typedef struct {
    char guid[40];
    unsigned version;
    int model_exchange;
    unsigned long long size;
    State s;
    unsigned long long checksum; /* of all members before it; set in serialized states only */
} Saved;
#define STATE_VERSION 2u
typedef char saved_has_no_gap[sizeof(Saved) == offsetof(Saved, checksum) + sizeof(unsigned long long) ? 1 : -1];

/* FNV-1a over words. If a single word differs, the sum always differs: every later step maps one to one. */
static unsigned long long checksum(const Saved *saved) {
    unsigned long long sum = 14695981039346656037ull, word;
    for (size_t i = 0; i < offsetof(Saved, checksum); i += sizeof word) {
        memcpy(&word, (const char *)saved + i, sizeof word);
        sum = (sum ^ word) * 1099511628211ull;
    }
    return sum;
}

/* Whether this FMU made the state and can continue from it: its bytes may come from anywhere. */
static int is_own(const Saved *saved) {
    return strncmp(saved->guid, MODEL_GUID, sizeof saved->guid) == 0 && saved->version == STATE_VERSION &&
           saved->size == sizeof *saved;
}

static int is_sound(const State *s) {
    const Fraction *fraction = &s->fraction;
    if (s->phase < INSTANTIATED || s->phase > CONTINUOUS_TIME || s->phase & (s->phase - 1)) return 0;
    for (int i = 0; i < STATE_0; i++) {
        const Variable *variable = &variables[i];
        if (!(isfinite(s->v[i]) && s->v[i] >= variable->min && s->v[i] <= variable->max)) return 0;
        if (variable->type != REAL && !(fabs(s->v[i]) <= 2147483647.0)) return 0;
    }
    if (!s->parameters_dirty && s->variant != variant_index(s->v)) return 0;
    if (!isfinite(s->start) || !isfinite(s->time) || !isfinite(s->origin) || !(s->stop > s->start)) return 0;
    if (!(isfinite(s->tolerance) && s->tolerance >= 0.0) || s->sample < 0 || s->steps < 0) return 0;
    if (!(s->per_sample == 0.0 || (s->per_sample >= 1.0 && s->per_sample <= MOST_PER_SAMPLE))) return 0;
    if (!(s->ahead >= 0.0 && s->ahead <= MOST_TICKS)) return 0;
    if (!(fraction->per_sample == 0.0 || (fraction->per_sample >= 1.0 && fraction->per_sample <= MOST_PER_SAMPLE)))
        return 0;
    if (!(fraction->ticks >= 0.0 && fraction->ticks <= MOST_TICKS)) return 0;
    return isfinite(s->integrator.step) && s->integrator.failing >= -1 &&
           s->integrator.failing < AT_LEAST_1(N_CONTINUOUS);
}

/* The memory that *saved points to; new memory if it is NULL. */
static Saved *memory_for(Instance *instance, void **saved, const char *function) {
    Saved *copy = (Saved *)(*saved ? *saved : calloc(1, sizeof *copy));
    if (!copy) {
        say(instance, ERROR, SAY_OUT_OF_MEMORY, function);
        fail(instance);
    }
    return copy;
}

static int save_state(Instance *instance, void **saved, const char *function) {
    Saved *copy;
    if (illegal(instance, MAY_HANDLE_STATE, function) || missing(instance, saved, 1, function)) return ERROR;
    copy = memory_for(instance, saved, function);
    if (!copy) return ERROR;
    memset(copy, 0, sizeof *copy);
    strncpy(copy->guid, MODEL_GUID, sizeof copy->guid - 1);
    copy->version = STATE_VERSION;
    copy->size = sizeof *copy;
    copy->model_exchange = instance->model_exchange;
    memcpy(&copy->s, &instance->s, sizeof copy->s);
    *saved = copy;
    return OK;
}

static int restore_state(Instance *instance, const void *from, const char *function) {
    const Saved *saved = (const Saved *)from;
    if (illegal(instance, MAY_HANDLE_STATE, function) || missing(instance, saved, 1, function)) return ERROR;
    if (!is_own(saved) || !is_sound(&saved->s)) {
        say(instance, ERROR, SAY_NO_STATE, function, MODEL_NAME);
        return fail(instance);
    }
    if (saved->model_exchange != instance->model_exchange) {
        say(instance, ERROR, SAY_OTHER_KIND, function, instance->model_exchange ? "co-simulation" : "model exchange");
        return fail(instance);
    }
    memcpy(&instance->s, &saved->s, sizeof instance->s);
    instance->s.variant = variant_index(instance->s.v);
    instance->s.finite =
        not_finite(states(&instance->s), N_STATES + N_OUTPUTS) < 0 && not_finite(instance->s.next, N_STATES) < 0;
    return OK;
}

static int free_state(Instance *instance, void **saved, const char *function) {
    if (illegal(instance, MAY_HANDLE_STATE, function)) return ERROR;
    if (!saved) return OK;
    free(*saved);
    *saved = NULL;
    return OK;
}

static int state_size(Instance *instance, const void *saved, size_t *size, const char *function) {
    if (illegal(instance, MAY_HANDLE_STATE, function) || missing(instance, saved, 1, function) ||
        missing(instance, size, 1, function))
        return ERROR;
    *size = sizeof(Saved);
    return OK;
}

static int serialize_state(Instance *instance, const void *saved, void *bytes, size_t size, const char *function) {
    unsigned long long sum;
    if (illegal(instance, MAY_HANDLE_STATE, function) || missing(instance, saved, 1, function) ||
        missing(instance, bytes, size, function))
        return ERROR;
    if (size < sizeof(Saved)) {
        say(instance, ERROR, SAY_FEW_BYTES, function, (unsigned long)size, (unsigned long)sizeof(Saved));
        return fail(instance);
    }
    sum = checksum((const Saved *)saved);
    memcpy(bytes, saved, sizeof(Saved));
    memcpy((char *)bytes + offsetof(Saved, checksum), &sum, sizeof sum);
    return OK;
}

static int deserialize_state(Instance *instance, const void *bytes, size_t size, void **saved, const char *function) {
    Saved found, *copy;
    if (illegal(instance, MAY_HANDLE_STATE, function) || missing(instance, bytes, size, function) ||
        missing(instance, saved, 1, function))
        return ERROR;
    if (size >= sizeof found) memcpy(&found, bytes, sizeof found);
    if (size < sizeof found || !is_own(&found)) {
        say(instance, ERROR, SAY_NO_STATE_BYTES, function, (unsigned long)size);
        return fail(instance);
    }
    if (found.checksum != checksum(&found) || !is_sound(&found.s)) {
        say(instance, ERROR, SAY_DAMAGED_BYTES, function, (unsigned long)size);
        return fail(instance);
    }
    copy = memory_for(instance, saved, function);
    if (!copy) return ERROR;
    memcpy(copy, &found, sizeof *copy);
    copy->checksum = 0;
    *saved = copy;
    return OK;
}
