/* The FMI 3.0 probe, and arrays of three of every type: y_TYPE[i] = u_TYPE[i]. From terminate_at on a step asks for the
 * end of the simulation, from early_at on it returns in its middle.
 */
#define fmi3InstantiateCoSimulation probe_instantiate
#define fmi3DoStep probe_do_step
#define fmi3GetFloat64 probe_get_float64
#define fmi3SetFloat64 probe_set_float64
#define fmi3GetBoolean probe_get_boolean
#define fmi3SetBoolean probe_set_boolean
#define fmi3GetInt64 probe_get_int64
#define fmi3SetInt64 probe_set_int64
#define fmi3GetFloat32 probe_get_float32
#define fmi3SetFloat32 probe_set_float32
#define fmi3GetInt8 probe_get_int8
#define fmi3SetInt8 probe_set_int8
#define fmi3GetUInt8 probe_get_uint8
#define fmi3SetUInt8 probe_set_uint8
#define fmi3GetInt16 probe_get_int16
#define fmi3SetInt16 probe_set_int16
#define fmi3GetUInt16 probe_get_uint16
#define fmi3SetUInt16 probe_set_uint16
#define fmi3GetInt32 probe_get_int32
#define fmi3SetInt32 probe_set_int32
#define fmi3GetUInt32 probe_get_uint32
#define fmi3SetUInt32 probe_set_uint32
#define fmi3GetUInt64 probe_get_uint64
#define fmi3SetUInt64 probe_set_uint64
#include "probe3.c"
#undef fmi3InstantiateCoSimulation
#undef fmi3DoStep
#undef fmi3GetFloat64
#undef fmi3SetFloat64
#undef fmi3GetBoolean
#undef fmi3SetBoolean
#undef fmi3GetInt64
#undef fmi3SetInt64
#undef fmi3GetFloat32
#undef fmi3SetFloat32
#undef fmi3GetInt8
#undef fmi3SetInt8
#undef fmi3GetUInt8
#undef fmi3SetUInt8
#undef fmi3GetInt16
#undef fmi3SetInt16
#undef fmi3GetUInt16
#undef fmi3SetUInt16
#undef fmi3GetInt32
#undef fmi3SetInt32
#undef fmi3GetUInt32
#undef fmi3SetUInt32
#undef fmi3GetUInt64
#undef fmi3SetUInt64
#include <string.h>

enum { TERMINATE_AT = 20, EARLY_AT, ARRAYS = 30 };

typedef struct {
    Probe probe;
    double terminate_at, early_at;
    fmi3Float64 Float64[3];
    fmi3Float32 Float32[3];
    fmi3Int8 Int8[3];
    fmi3UInt8 UInt8[3];
    fmi3Int16 Int16[3];
    fmi3UInt16 UInt16[3];
    fmi3Int32 Int32[3];
    fmi3UInt32 UInt32[3];
    fmi3Int64 Int64[3];
    fmi3UInt64 UInt64[3];
    fmi3Boolean Boolean[3];
} Echo;

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    Echo *e = realloc(probe_instantiate(name, token, resources, visible, logging, events, early, required, n,
                                        environment, log, update),
                      sizeof *e);
    memset((char *)e + sizeof e->probe, 0, sizeof *e - sizeof e->probe);
    e->terminate_at = e->early_at = 1e9;
    return e;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    Echo *e = c;
    const bool returns = t + h >= e->early_at - 1e-9;
    probe_do_step(c, t, returns ? h / 2 : h, no_set, event, terminate, early, last);
    *terminate = t + h >= e->terminate_at - 1e-9;
    *early = returns;
    return fmi3OK;
}

/* The only input and the only output of a type are arrays of three. */
#define EXCHANGE(type)                                                                                          \
    fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##type value[], \
                             size_t values) {                                                                   \
        Echo *e = c;                                                                                            \
        if (vr[0] < ARRAYS) return other_set_##type(e, vr, n, value, values);                                   \
        if (n != 1 || values != 3) return fmi3Error;                                                            \
        memcpy(e->type, value, sizeof e->type);                                                                 \
        return fmi3OK;                                                                                          \
    }                                                                                                           \
    fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##type value[],       \
                             size_t values) {                                                                   \
        Echo *e = c;                                                                                            \
        if (vr[0] < ARRAYS) return other_get_##type(e, vr, n, value, values);                                   \
        if (n != 1 || values != 3) return fmi3Error;                                                            \
        memcpy(value, e->type, sizeof e->type);                                                                 \
        return fmi3OK;                                                                                          \
    }
#define NO_OTHER(type)                                                                                             \
    static fmi3Status other_set_##type(Echo *e, const fmi3ValueReference vr[], size_t n, const fmi3##type value[], \
                                       size_t values) {                                                            \
        (void)e, (void)vr, (void)n, (void)value, (void)values;                                                     \
        return fmi3Error;                                                                                          \
    }                                                                                                              \
    static fmi3Status other_get_##type(Echo *e, const fmi3ValueReference vr[], size_t n, fmi3##type value[],       \
                                       size_t values) {                                                            \
        (void)e, (void)vr, (void)n, (void)value, (void)values;                                                     \
        return fmi3Error;                                                                                          \
    }                                                                                                              \
    EXCHANGE(type)
static fmi3Status other_set_Float64(Echo *e, const fmi3ValueReference vr[], size_t n, const fmi3Float64 value[],
                                    size_t values) {
    if (vr[0] < TERMINATE_AT) return probe_set_float64(e, vr, n, value, values);
    *(vr[0] == TERMINATE_AT ? &e->terminate_at : &e->early_at) = value[0];
    return n == 1 ? fmi3OK : fmi3Error;
}
#define other_get_Float64 probe_get_float64
EXCHANGE(Float64)
NO_OTHER(Float32)
NO_OTHER(Int8)
NO_OTHER(UInt8)
NO_OTHER(Int16)
NO_OTHER(UInt16)
NO_OTHER(Int32)
NO_OTHER(UInt32)
NO_OTHER(Int64)
NO_OTHER(UInt64)
NO_OTHER(Boolean)
