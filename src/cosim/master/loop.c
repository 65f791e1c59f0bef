/* The inner loop of the master. It executes the rows of a program for each communication point. loop.py describes the
 * columns of a row and the elements of `state`. loop_plain.py does the same in Python.
 */
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
/* For functions that are rarely called: not inlined, because every instruction counts in `advance`. */
#define RARE static __attribute__((noinline))
#define LIKELY(condition) __builtin_expect(condition, 1)

enum { CALL_REAL, STEP_GET_REAL, NOTHING, EXCHANGE, ADD, TABLE, GUARD };
enum { FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, BOOLEAN8, BOOLEAN32 };
enum { POINT, ROWS, WARNINGS, CALLING, REASON, STATUS, FAILED_LINK, FAILED_SLOT, LAST_TIME };
enum { DONE, CALL_FAILED, NOT_FINITE, OUT_OF_RANGE, TERMINATED, RETURNED_EARLY };

typedef int Exchange2(void *, const uint32_t *, size_t, void *);
typedef int Exchange3(void *, const uint32_t *, size_t, void *, size_t);
typedef int Step2(void *, double, double, int);
typedef int Step3(void *, double, double, bool, bool *, bool *, bool *, double *);

typedef struct {
    int64_t act, fmi;
    void *component;
    union {
        Step2 *two;
        Step3 *three;
    } step;
    int64_t step_call, multiple, link, links;
    union {
        Exchange2 *two;
        Exchange3 *three;
    } function;
    int64_t call;
    const uint32_t *references;
    int64_t reference_count, count;
    void *buffer;
    int64_t slot, type, set;
} Row;

typedef struct {
    int64_t source, target;
    double factor, offset;
} Link;

RARE bool stopped(int64_t *state, int reason, int place, int64_t what) {
    state[REASON] = reason;
    state[place] = what;
    return false;
}

/* Count a status other than OK. Returns false, and stops the loop, unless the status is Warning. */
RARE bool tolerated(int64_t *state, int status) {
    state[WARNINGS]++;
    return status == 1 || stopped(state, CALL_FAILED, STATUS, status);
}

static bool step_over(const Row *row, double begin, double length, int64_t *state) {
    state[CALLING] = row->step_call;
    bool event = false, terminate = false, early = false;
    double last = begin;
    const int status = row->fmi == 2
                           ? row->step.two(row->component, begin, length, 1)
                           : row->step.three(row->component, begin, length, true, &event, &terminate, &early, &last);
    memcpy(&state[LAST_TIME], &last, sizeof last);
    if (!LIKELY(status == 0) && !tolerated(state, status)) return false;
    return !(terminate || early) || stopped(state, terminate ? TERMINATED : RETURNED_EARLY, STATUS, status);
}

#define CONVERT(code, type, least, most)                                                                 \
    case code:                                                                                           \
        for (int64_t i = 0; i < row->count; i++) {                                                       \
            if (!row->set) {                                                                             \
                real[i] = (double)((const type *)row->buffer)[i];                                        \
                continue;                                                                                \
            }                                                                                            \
            const double value = rint(real[i]);                                                          \
            const bool low = !(value >= (least)), high = value > (most);                                 \
            if ((low || high) && check) return stopped(state, OUT_OF_RANGE, FAILED_SLOT, row->slot + i); \
            ((type *)row->buffer)[i] = low ? (type)(least) : high ? (type)(most) : (type)value;          \
        }                                                                                                \
        return true;
#define BOOLEAN(code, type)                                       \
    case code:                                                    \
        for (int64_t i = 0; i < row->count; i++)                  \
            if (row->set)                                         \
                ((type *)row->buffer)[i] = real[i] != 0.0;        \
            else                                                  \
                real[i] = (double)((const type *)row->buffer)[i]; \
        return true;

/* Convert between slots (double) and the buffer of a call with another type: to the buffer if the call sets values. */
static bool convert(const Row *row, double *values, int64_t *state, bool check) {
    double *const real = values + row->slot;
    switch (row->type) {
        CONVERT(INT8, int8_t, INT8_MIN, INT8_MAX)
        CONVERT(UINT8, uint8_t, 0, UINT8_MAX)
        CONVERT(INT16, int16_t, INT16_MIN, INT16_MAX)
        CONVERT(UINT16, uint16_t, 0, UINT16_MAX)
        CONVERT(INT32, int32_t, INT32_MIN, INT32_MAX)
        CONVERT(UINT32, uint32_t, 0, UINT32_MAX)
        CONVERT(INT64, int64_t, -0x1p63, 0x1.fffffffffffffp62)
        CONVERT(UINT64, uint64_t, 0, 0x1.fffffffffffffp63)
        BOOLEAN(BOOLEAN8, uint8_t)
        BOOLEAN(BOOLEAN32, int32_t)
        case FLOAT64:
            return true;
    }
    for (int64_t i = 0; i < row->count; i++)
        if (!row->set)
            real[i] = (double)((const float *)row->buffer)[i];
        else if (fabs(real[i]) > FLT_MAX && check)
            return stopped(state, OUT_OF_RANGE, FAILED_SLOT, row->slot + i);
        else
            ((float *)row->buffer)[i] = (float)real[i];
    return true;
}

static bool exchange(const Row *row, double *values, int64_t *state, bool check) {
    if (row->set && !convert(row, values, state, check)) return false;
    state[CALLING] = row->call;
    const size_t n = (size_t)row->reference_count;
    const int status = row->fmi == 2
                           ? row->function.two(row->component, row->references, n, row->buffer)
                           : row->function.three(row->component, row->references, n, row->buffer, (size_t)row->count);
    return (status == 0 || tolerated(state, status)) && (row->set || convert(row, values, state, check));
}

/* Set the targets of the connections of a row to their values, or add the values to the targets. `link` and `links` of
 * the row are in bytes. */
static inline bool carry(const Row *row, const Link *links, double *values, int64_t *state, bool check, bool add) {
    const Link *link = (const Link *)((const char *)links + row->link);
    const Link *const end = (const Link *)((const char *)link + row->links);
#pragma clang loop unroll(disable)
    for (; link != end; link++) {
        const double given = link->factor * values[link->source] + link->offset;
        const double value = add ? values[link->target] + given : given;
        if (!LIKELY(fabs(value) <= DBL_MAX) && check) return stopped(state, NOT_FINITE, FAILED_LINK, link - links);
        values[link->target] = value;
    }
    return true;
}

/* Execute a row that is not GUARD and has no fast path. Its step begins at `begin` and takes `length`, both in s.
 * `passed` is the number of points since `advance` began. */
RARE bool other(const Row *row, const Link *links, double *values, double begin, double length, int64_t passed,
                int64_t *state, bool check) {
    if (row->step.two != NULL && !step_over(row, begin, length, state)) return false;
    if (!carry(row, links, values, state, check, row->act == ADD)) return false;
    if (row->act == EXCHANGE) return exchange(row, values, state, check);
    if (row->act == TABLE) {
        const double *const table = (const double *)row->buffer + passed * row->count;
        memcpy(values + row->slot, table, (size_t)row->count * sizeof *table);
    }
    return true;
}

EXPORT int advance(const Row *rows, int64_t size, int64_t split, const Link *links, double *values,
                   const int64_t *recorded, int64_t columns, double *record, double start, double step, int64_t *state,
                   int64_t end, int64_t last, int64_t every, int check) {
    const Row *row = rows, *const middle = rows + split, *stop = middle;
    const int64_t first = state[POINT];
    int64_t due = first;
    double *next = record + state[ROWS] * columns;
    double time = start + (double)due * step;
    for (bool going = due < end || due == last; going;) {
        for (; row != stop; row++) {
            if (LIKELY(row->act == CALL_REAL)) {
                if (!carry(row, links, values, state, check, false)) return 0;
            } else if (LIKELY(row->act == STEP_GET_REAL)) {
                state[CALLING] = row->step_call;
                const int status = row->step.two(row->component, time, step, 1);
                if (!LIKELY(status == 0) && !tolerated(state, status)) return 0;
            } else if (row->act == GUARD) {
                if (due % row->multiple != 0) row += row->count;
                continue;
            } else {
                const double begin = start + (double)(due - row->multiple) * step;
                const double length = (double)row->multiple * step;
                if (!other(row, links, values, begin, length, due - first, state, check)) return 0;
                continue;
            }
            state[CALLING] = row->call;
            const int status = row->function.two(row->component, row->references, (size_t)row->count, row->buffer);
            if (!LIKELY(status == 0) && !tolerated(state, status)) return 0;
        }
        if (stop == middle) {
            if (LIKELY(every == 1) || due % every == 0) {
#pragma clang loop unroll(disable) vectorize(disable)
                for (int64_t column = 0; column < columns; column++) next[column] = values[recorded[column]];
                next += columns;
                state[ROWS]++;
            }
            going = due++ != last;
            stop = rows + size;
        } else {
            state[POINT] = due;
            going = due < end || due == last;
            time = start + (double)due * step;
            row = rows;
            stop = middle;
        }
    }
    state[POINT] = end;
    state[CALLING] = -1;
    return 1;
}
