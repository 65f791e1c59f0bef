/* The binary of a Python FMU: loads PythonFMU's library beside it and passes every call on.

   It adds what PythonFMU 0.7 lacks: resource paths of any form, the guid check, statuses other than OK and Fatal (they
   come with the slave's log messages), log categories, checks of pointers, FMU states that can be overwritten and are
   checked when read back, and a Python interpreter if the importer's process has none. */
#if !defined _WIN32
#define _GNU_SOURCE
#endif
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "contract.h"
#include "fmi2.h"
#include "log.h"

#if defined _WIN32
#include <windows.h>
#define PYTHONFMU "pythonfmu-export.dll"
#else
#include <dlfcn.h>
#define PYTHONFMU "libpythonfmu-export.so"
#endif

#define MAX_PATH_BYTES 4096
#define GUID_BYTES 40

typedef struct {
    fmi2Component (*Instantiate)(fmi2String, fmi2Type, fmi2String, fmi2String, const fmi2CallbackFunctions *,
                                 fmi2Boolean, fmi2Boolean);
    void (*FreeInstance)(fmi2Component);
    fmi2Status (*SetupExperiment)(fmi2Component, fmi2Boolean, fmi2Real, fmi2Real, fmi2Boolean, fmi2Real);
    fmi2Status (*EnterInitializationMode)(fmi2Component);
    fmi2Status (*ExitInitializationMode)(fmi2Component);
    fmi2Status (*Terminate)(fmi2Component);
    fmi2Status (*Reset)(fmi2Component);
    fmi2Status (*GetReal)(fmi2Component, const fmi2ValueReference[], size_t, fmi2Real[]);
    fmi2Status (*GetInteger)(fmi2Component, const fmi2ValueReference[], size_t, fmi2Integer[]);
    fmi2Status (*GetBoolean)(fmi2Component, const fmi2ValueReference[], size_t, fmi2Boolean[]);
    fmi2Status (*GetString)(fmi2Component, const fmi2ValueReference[], size_t, fmi2String[]);
    fmi2Status (*SetReal)(fmi2Component, const fmi2ValueReference[], size_t, const fmi2Real[]);
    fmi2Status (*SetInteger)(fmi2Component, const fmi2ValueReference[], size_t, const fmi2Integer[]);
    fmi2Status (*SetBoolean)(fmi2Component, const fmi2ValueReference[], size_t, const fmi2Boolean[]);
    fmi2Status (*SetString)(fmi2Component, const fmi2ValueReference[], size_t, const fmi2String[]);
    fmi2Status (*GetFMUstate)(fmi2Component, fmi2FMUstate *);
    fmi2Status (*SetFMUstate)(fmi2Component, fmi2FMUstate);
    fmi2Status (*FreeFMUstate)(fmi2Component, fmi2FMUstate *);
    fmi2Status (*SerializedFMUstateSize)(fmi2Component, fmi2FMUstate, size_t *);
    fmi2Status (*SerializeFMUstate)(fmi2Component, fmi2FMUstate, fmi2Byte[], size_t);
    fmi2Status (*DeSerializeFMUstate)(fmi2Component, const fmi2Byte[], size_t, fmi2FMUstate *);
    fmi2Status (*DoStep)(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean);
} Functions;

static const char *const function_names[] = {"fmi2Instantiate",
                                             "fmi2FreeInstance",
                                             "fmi2SetupExperiment",
                                             "fmi2EnterInitializationMode",
                                             "fmi2ExitInitializationMode",
                                             "fmi2Terminate",
                                             "fmi2Reset",
                                             "fmi2GetReal",
                                             "fmi2GetInteger",
                                             "fmi2GetBoolean",
                                             "fmi2GetString",
                                             "fmi2SetReal",
                                             "fmi2SetInteger",
                                             "fmi2SetBoolean",
                                             "fmi2SetString",
                                             "fmi2GetFMUstate",
                                             "fmi2SetFMUstate",
                                             "fmi2FreeFMUstate",
                                             "fmi2SerializedFMUstateSize",
                                             "fmi2SerializeFMUstate",
                                             "fmi2DeSerializeFMUstate",
                                             "fmi2DoStep"};

typedef struct Instance {
    fmi2CallbackFunctions importer;
    fmi2CallbackFunctions own;
    Functions slave_functions;
    fmi2Component slave; /* of PythonFMU: an instance of another type */
    void *library;
    int dead;            /* a Python exception escaped: PythonFMU has released its objects, nothing may be called */
    unsigned categories; /* bit of each category that is logged */
    fmi2Status worst;    /* of the messages of the call in progress */
    fmi2Real reached;    /* s, end of the last step done */
    char guid[GUID_BYTES];
    char *name;
} Instance;

/* ---- messages ---- */

static void deliver(const Instance *instance, fmi2Status status, const char *text) {
    const unsigned category = category_of((int)status);
    const size_t length = strlen(text);
    char *plain;
    if (!instance->importer.logger || !is_wanted(instance->categories, category)) return;
    plain = malloc(length + 1);
    if (!plain) return;
    for (size_t i = 0; i <= length; i++)
        plain[i] = text[i] == '%' ? '#' : text[i]; /* some importers take the message as a format */
    instance->importer.logger(instance->importer.componentEnvironment, instance->name, status, category_names[category],
                              plain);
    free(plain);
}

#if defined __clang__ || defined __GNUC__
__attribute__((format(printf, 3, 4)))
#endif
static void say(const Instance *instance, fmi2Status status, const char *format, ...) {
    char text[2 * MAX_PATH_BYTES];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    deliver(instance, status, text);
}

/* PythonFMU passes the slave's messages here, each with the status that the call shall return. A warning does not
   change the status of the call. */
static void receive(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                    fmi2String text, ...) {
    static const char prefix[] = "Fatal py exception encountered: ";
    Instance *instance = environment;
    (void)name;
    (void)category;
    if (status > fmi2Warning && status > instance->worst) instance->worst = status;
    if (strncmp(text, prefix, sizeof prefix - 1) == 0) {
        const char *line = strchr(text, '\n');
        text = line ? line + 1 : text;
    }
    deliver(instance, status, text);
}

static int unusable(Instance *instance) {
    if (!instance) return 1;
    instance->worst = fmi2OK;
    if (!instance->dead) return 0;
    say(instance, fmi2Error, "the instance has failed in Python. Free it and instantiate it again.");
    return 1;
}

static fmi2Status finish(Instance *instance, fmi2Status status) {
    if (status == fmi2Fatal) {
        instance->dead = 1;
        return fmi2Fatal;
    }
    return status > instance->worst ? status : instance->worst;
}

static int missing(Instance *instance, const void *pointer, size_t n, const char *function) {
    if (pointer || n == 0) return 0;
    say(instance, fmi2Error, SAY_NULL_ARGUMENT, function, (unsigned long)n);
    return 1;
}

/* ---- libraries ---- */

#if defined _WIN32
static int own_folder(char *path, size_t size) {
    HMODULE module;
    char *end;
    if (!GetModuleHandleExA(GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                            (LPCSTR)&category_names, &module))
        return 0;
    const DWORD length = GetModuleFileNameA(module, path, (DWORD)size);
    if (length == 0 || length >= size) return 0;
    end = strrchr(path, '\\');
    if (end) *end = 0;
    return 1;
}
static int python_is_loaded(void) { return GetModuleHandleA("python3.dll") != NULL; }
static void *load_python(void) { return (void *)LoadLibraryA("python3.dll"); }
static void *load(const char *path) { return (void *)LoadLibraryExA(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH); }
static void unload(void *library) { FreeLibrary((HMODULE)library); }
static void guard_exit(void *library) { (void)library; }
static void *symbol(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
static const char *load_problem(void) { return "LoadLibrary failed"; }
#else
static int own_folder(char *path, size_t size) {
    Dl_info info;
    char *end;
    if (!dladdr((const void *)&category_names, &info) || strlen(info.dli_fname) >= size) return 0;
    strcpy(path, info.dli_fname);
    end = strrchr(path, '/');
    if (!end) return 0;
    *end = 0;
    return 1;
}
static int python_is_loaded(void) { return dlsym(RTLD_DEFAULT, "Py_IsInitialized") != NULL; }
/* The Python library: the one that COSIM_LIBPYTHON names; else the one already in the process; else the newest
   installed. */
static void *load_python(void) {
    static const int modes[] = {RTLD_NOW | RTLD_GLOBAL | RTLD_NOLOAD, RTLD_NOW | RTLD_GLOBAL};
    const char *named = getenv("COSIM_LIBPYTHON");
    char name[64];
    void *library;
    if (named && *named) return dlopen(named, RTLD_NOW | RTLD_GLOBAL);
    for (int pass = 0; pass < 2; pass++)
        for (int minor = 20; minor >= 11; minor--) {
            snprintf(name, sizeof name, "libpython3.%d.so.1.0", minor);
            library = dlopen(name, modes[pass]);
            if (library) return library;
        }
    return NULL;
}
static void *load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void unload(void *library) { (void)library; } /* its C++ runtime keeps it loaded anyway */

/* At exit PythonFMU 0.7 releases an object twice, which uses freed memory. The function below is registered after the
   library's own clean-up, so it runs before it and leaves nothing to release. */
static void (*finalize)(void);
static void before_exit(void) { finalize(); }
static void guard_exit(void *library) {
    Dl_info info;
    if (finalize || !dladdr((const void *)&category_names, &info)) return;
    if (!dlopen(info.dli_fname, RTLD_NOW | RTLD_NOLOAD | RTLD_NODELETE)) return; /* keep it: its code runs at exit */
    finalize = dlsym(library, "finalizePythonInterpreter");
    if (finalize) atexit(before_exit);
}
static void *symbol(void *library, const char *name) { return dlsym(library, name); }
static const char *load_problem(void) { return dlerror(); }
#endif

/* Start Python for the rest of the process. PythonFMU would end it at unloading, but numpy cannot be loaded twice. */
static int start_python(void) {
    void *library = load_python();
    int (*is_started)(void) = library ? symbol(library, "Py_IsInitialized") : NULL;
    void (*start)(int) = library ? symbol(library, "Py_InitializeEx") : NULL;
    void *(*release)(void) = library ? symbol(library, "PyEval_SaveThread") : NULL;
    if (!is_started || !start || !release) return 0;
    if (!is_started()) {
        start(0);
        release();
    }
    return 1;
}

static int load_slave(Instance *instance) {
    char path[MAX_PATH_BYTES];
    void *found[sizeof function_names / sizeof *function_names];
    if (!python_is_loaded() && !start_python()) {
        say(instance, fmi2Error,
            "fmi2Instantiate: no Python in this process and no library of Python 3.11 or later found. "
            "Set COSIM_LIBPYTHON to the path of libpython3.x.so, or take the native FMU of the same name.");
        return 0;
    }
    if (!own_folder(path, sizeof path - sizeof "/" PYTHONFMU)) return 0;
    strcat(path, "/" PYTHONFMU);
    instance->library = load(path);
    if (!instance->library) {
        say(instance, fmi2Error, "fmi2Instantiate: %s cannot be loaded: %s.", path, load_problem());
        return 0;
    }
    guard_exit(instance->library);
    for (size_t i = 0; i < sizeof found / sizeof *found; i++) {
        found[i] = symbol(instance->library, function_names[i]);
        if (!found[i]) {
            say(instance, fmi2Error, "fmi2Instantiate: %s has no %s. Unpack the FMU again.", path, function_names[i]);
            return 0;
        }
    }
    memcpy(&instance->slave_functions, found, sizeof found);
    return 1;
}

/* ---- resources ---- */

/* Whether Python can decode a text: PythonFMU crashes if it cannot. */
static int is_utf8(const char *text) {
    const unsigned char *p = (const unsigned char *)text;
    while (*p) {
        const unsigned char first = *p++;
        /* bounds of the second byte: no overlong form, no surrogate, nothing above U+10FFFF */
        unsigned char low = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
        unsigned char high = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
        int following = first < 0x80 ? 0 : first < 0xE0 ? 1 : first < 0xF0 ? 2 : 3;
        if ((first >= 0x80 && first < 0xC2) || first > 0xF4) return 0;
        for (; following > 0; following--) {
            if (*p < low || *p > high) return 0;
            p++;
            low = 0x80;
            high = 0xBF;
        }
    }
    return 1;
}

static int hexadecimal(char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

static FILE *open_resource(const char *folder, const char *name) {
    char path[MAX_PATH_BYTES + 32];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return fopen(path, "r");
}

/* The folder of the resources: the path of the URI with all escapes decoded; the folder resources/ beside binaries/ if
   that path does not hold them. */
static int resource_folder(const Instance *instance, const char *uri, char *folder) {
    size_t n = 0;
    FILE *file;
    const char *p = uri ? uri : "";
    if (strlen(p) < MAX_PATH_BYTES) {
        if (strncmp(p, "file:", 5) == 0) {
            p += 5;
            if (strncmp(p, "//", 2) == 0) {
                p += 2;
                while (*p && *p != '/') p++;
            }
#if defined _WIN32
            if (*p == '/') p++;
#endif
        }
        for (; *p; p++) {
            const int high = *p == '%' ? hexadecimal(p[1]) : -1;
            const int low = high >= 0 ? hexadecimal(p[2]) : -1;
            if (low >= 0) p += 2;
            folder[n++] = low >= 0 ? (char)(16 * high + low) : *p;
        }
        while (n > 1 && (folder[n - 1] == '/' || folder[n - 1] == '\\')) n--;
    }
    folder[n] = 0;
    file = open_resource(folder, "slavemodule.txt");
    if (!file && own_folder(folder, MAX_PATH_BYTES - 32)) {
        strcat(folder, "/../../resources");
        file = open_resource(folder, "slavemodule.txt");
    }
    if (!file) {
        say(instance, fmi2Error,
            "fmi2Instantiate: no slavemodule.txt in the resource location '%s'. Pass the URI of the "
            "FMU's resources folder.",
            uri ? uri : "");
        return 0;
    }
    fclose(file);
    if (strstr(folder, "%20") || strstr(folder, "file://")) {
        say(instance, fmi2Error,
            "fmi2Instantiate: the folder '%s' has an escaped blank or file:// in its name, which PythonFMU cannot "
            "read. Unpack the FMU elsewhere.",
            folder);
        return 0;
    }
    if (!is_utf8(folder)) {
        say(instance, fmi2Error,
            "fmi2Instantiate: the name of the folder '%s' is not UTF-8, which Python cannot read. Unpack the FMU "
            "elsewhere.",
            folder);
        return 0;
    }
    return 1;
}

static int read_guid(Instance *instance, const char *folder) {
    FILE *file = open_resource(folder, "guid.txt");
    size_t length;
    char *end;
    if (!file) return 0;
    length = fread(instance->guid, 1, GUID_BYTES - 1, file);
    fclose(file);
    instance->guid[length] = 0;
    end = strpbrk(instance->guid, "\r\n");
    if (end) *end = 0;
    return 1;
}

/* ---- life cycle ---- */

FMI2_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI2_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

FMI2_EXPORT void fmi2FreeInstance(fmi2Component c) {
    Instance *instance = c;
    if (!instance) return;
    if (instance->slave && !instance->dead) instance->slave_functions.FreeInstance(instance->slave);
    if (instance->library && !instance->dead) unload(instance->library);
    free(instance);
}

FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                          fmi2Boolean logging) {
    static const char function[] = "fmi2Instantiate";
    char folder[MAX_PATH_BYTES];
    Instance *instance;
    const size_t length = strlen(name ? name : "") + 1;
    if (!callbacks) return NULL;
    instance = calloc(1, sizeof *instance + length);
    if (!instance) return NULL;
    instance->name = (char *)(instance + 1);
    memcpy(instance->name, name ? name : "", length);
    instance->importer = *callbacks;
    instance->own.logger = receive;
    instance->own.allocateMemory = calloc; /* not the importer's functions: those of some importers are broken */
    instance->own.freeMemory = free;
    instance->own.componentEnvironment = instance;
    instance->categories = EVERY_CATEGORY; /* the reason of a refused instance is always logged */
    if (!*instance->name) {
        say(instance, fmi2Error, SAY_NO_NAME, function);
    } else if (type != fmi2CoSimulation) {
        say(instance, fmi2Error, SAY_CO_SIMULATION_ONLY, function);
    } else if (resource_folder(instance, resources, folder) && read_guid(instance, folder)) {
        if (!guid || strcmp(guid, instance->guid) != 0)
            say(instance, fmi2Error, SAY_WRONG_TOKEN, function, guid ? guid : "", instance->guid);
        else if (load_slave(instance))
            instance->slave =
                instance->slave_functions.Instantiate(is_utf8(instance->name) ? instance->name : "instance", type, guid,
                                                      folder, &instance->own, visible, fmi2True);
    }
    if (!instance->slave) {
        fmi2FreeInstance(instance);
        return NULL;
    }
    instance->categories = logging ? EVERY_CATEGORY : ONLY_ERRORS;
    return instance;
}

FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    static const char function[] = "fmi2SetDebugLogging";
    Instance *instance = c;
    unsigned categories = 0;
    if (unusable(instance) || missing(instance, names, n, function)) return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        const unsigned bit = category_bit(names[i]);
        if (!bit) {
            say(instance, fmi2Error, SAY_UNKNOWN_CATEGORY, function, names[i] ? names[i] : "");
            return fmi2Error;
        }
        categories |= bit;
    }
    instance->categories = !on ? ONLY_ERRORS : n ? categories : EVERY_CATEGORY;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                           fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *instance = c;
    if (unusable(instance)) return fmi2Error;
    instance->reached = start;
    return finish(instance, instance->slave_functions.SetupExperiment(instance->slave, tolerance_defined, tolerance,
                                                                      start, stop_defined, stop));
}

#define FORWARD(function)                                                             \
    FMI2_EXPORT fmi2Status fmi2##function(fmi2Component c) {                          \
        Instance *instance = c;                                                       \
        if (unusable(instance)) return fmi2Error;                                     \
        return finish(instance, instance->slave_functions.function(instance->slave)); \
    }
FORWARD(EnterInitializationMode)
FORWARD(ExitInitializationMode)
FORWARD(Terminate)
FORWARD(Reset)

FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
    Instance *instance = c;
    fmi2Status status;
    if (unusable(instance)) return fmi2Error;
    status = instance->slave_functions.DoStep(instance->slave, time, step, no_rollback);
    if (status != fmi2Fatal && instance->worst > fmi2Warning)
        status = instance->worst;
    else
        status = finish(instance, status);
    if (status == fmi2OK || status == fmi2Warning) instance->reached = time + step;
    return status;
}

/* ---- values ---- */

#define VALUES(function, type)                                                                               \
    FMI2_EXPORT fmi2Status fmi2##function(fmi2Component c, const fmi2ValueReference references[], size_t n,  \
                                          type values[]) {                                                   \
        Instance *instance = c;                                                                              \
        if (unusable(instance) || missing(instance, references, n, "fmi2" #function) ||                      \
            missing(instance, values, n, "fmi2" #function))                                                  \
            return fmi2Error;                                                                                \
        return finish(instance, instance->slave_functions.function(instance->slave, references, n, values)); \
    }
VALUES(GetReal, fmi2Real)
VALUES(GetInteger, fmi2Integer)
VALUES(GetBoolean, fmi2Boolean)
VALUES(GetString, fmi2String)
VALUES(SetReal, const fmi2Real)
VALUES(SetInteger, const fmi2Integer)
VALUES(SetBoolean, const fmi2Boolean)
VALUES(SetString, const fmi2String)

/* Calls on variables that these FMUs do not have: only n == 0 is allowed. The text begins with the function. */
#define NOT_PROVIDED(instance, n, text, function) \
    do {                                          \
        if (unusable(instance)) return fmi2Error; \
        if ((n) == 0) return fmi2OK;              \
        say(instance, fmi2Error, text, function); \
        return fmi2Error;                         \
    } while (0)

FMI2_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                   const fmi2Integer orders[], const fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    NOT_PROVIDED(c, n, SAY_NO_INPUT_DERIVATIVES, "fmi2SetRealInputDerivatives");
}

FMI2_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference references[], size_t n,
                                                    const fmi2Integer orders[], fmi2Real values[]) {
    (void)references;
    (void)orders;
    (void)values;
    NOT_PROVIDED(c, n, SAY_NO_OUTPUT_DERIVATIVES, "fmi2GetRealOutputDerivatives");
}

FMI2_EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[],
                                                    size_t n_unknown, const fmi2ValueReference knowns[], size_t n_known,
                                                    const fmi2Real seed[], fmi2Real result[]) {
    (void)unknowns;
    (void)knowns;
    (void)n_known;
    (void)seed;
    (void)result;
    NOT_PROVIDED(c, n_unknown, "%s: not provided by the Python flavour. Take the native FMU.",
                 "fmi2GetDirectionalDerivative");
}

/* ---- FMU state ---- */

/* Header of a serialized state; the slave's own bytes follow it. */
typedef struct {
    char guid[GUID_BYTES];
    unsigned long long version;
    unsigned long long size;     /* of head and bytes */
    unsigned long long checksum; /* of head (without this member) and bytes */
} Head;
#define STATE_VERSION 2

/* FNV-1a. If a single byte differs, the sum always differs: every later step maps one to one. */
static unsigned long long added(unsigned long long sum, const void *content, size_t size) {
    const unsigned char *bytes = content;
    for (size_t i = 0; i < size; i++) sum = (sum ^ bytes[i]) * 1099511628211ull;
    return sum;
}

static unsigned long long checksum(const Head *head, const fmi2Byte *bytes) {
    const unsigned long long sum = added(14695981039346656037ull, head, offsetof(Head, checksum));
    return added(sum, bytes, (size_t)head->size - sizeof *head);
}

FMI2_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    Instance *instance = c;
    fmi2Status status;
    if (unusable(instance)) return fmi2Error;
    if (!saved || !*saved) return fmi2OK;
    status = finish(instance, instance->slave_functions.FreeFMUstate(instance->slave, saved));
    *saved = NULL;
    return status;
}

FMI2_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved) {
    Instance *instance = c;
    if (unusable(instance) || missing(instance, saved, 1, "fmi2GetFMUstate")) return fmi2Error;
    if (fmi2FreeFMUstate(c, saved) != fmi2OK) return fmi2Error;
    return finish(instance, instance->slave_functions.GetFMUstate(instance->slave, saved));
}

FMI2_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved) {
    Instance *instance = c;
    if (unusable(instance) || missing(instance, saved, 1, "fmi2SetFMUstate")) return fmi2Error;
    return finish(instance, instance->slave_functions.SetFMUstate(instance->slave, saved));
}

FMI2_EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size) {
    Instance *instance = c;
    fmi2Status status;
    if (unusable(instance) || missing(instance, saved, 1, "fmi2SerializedFMUstateSize") ||
        missing(instance, size, 1, "fmi2SerializedFMUstateSize"))
        return fmi2Error;
    status = finish(instance, instance->slave_functions.SerializedFMUstateSize(instance->slave, saved, size));
    *size += sizeof(Head);
    return status;
}

FMI2_EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size) {
    Instance *instance = c;
    static const char function[] = "fmi2SerializeFMUstate";
    fmi2Status status;
    Head head;
    size_t needed;
    if (unusable(instance) || missing(instance, bytes, size, function)) return fmi2Error;
    if (fmi2SerializedFMUstateSize(c, saved, &needed) != fmi2OK) return fmi2Error;
    if (size < needed) {
        say(instance, fmi2Error, SAY_FEW_BYTES, function, (unsigned long)size, (unsigned long)needed);
        return fmi2Error;
    }
    memset(&head, 0, sizeof head);
    memcpy(head.guid, instance->guid, sizeof head.guid);
    head.size = needed;
    head.version = STATE_VERSION;
    status = finish(instance, instance->slave_functions.SerializeFMUstate(instance->slave, saved, bytes + sizeof head,
                                                                          needed - sizeof head));
    head.checksum = checksum(&head, bytes + sizeof head);
    memcpy(bytes, &head, sizeof head);
    return status;
}

FMI2_EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                               fmi2FMUstate *saved) {
    Instance *instance = c;
    static const char function[] = "fmi2DeSerializeFMUstate";
    Head head;
    if (unusable(instance) || missing(instance, bytes, size, function) || missing(instance, saved, 1, function))
        return fmi2Error;
    memset(&head, 0, sizeof head);
    if (size >= sizeof head) memcpy(&head, bytes, sizeof head);
    if (head.size < sizeof head || head.size > size || head.version != STATE_VERSION ||
        memcmp(head.guid, instance->guid, sizeof head.guid) != 0) {
        say(instance, fmi2Error, SAY_NO_STATE_BYTES, function, (unsigned long)size);
        return fmi2Error;
    }
    if (head.checksum != checksum(&head, bytes + sizeof head)) {
        say(instance, fmi2Error, SAY_DAMAGED_BYTES, function, (unsigned long)size);
        return fmi2Error;
    }
    if (fmi2FreeFMUstate(c, saved) != fmi2OK) return fmi2Error;
    return finish(instance, instance->slave_functions.DeSerializeFMUstate(instance->slave, bytes + sizeof head,
                                                                          (size_t)head.size - sizeof head, saved));
}

/* ---- model exchange: not offered, but some importers look for these functions in every FMU ---- */

#define NO_EXCHANGE(function, ...)                                                                                 \
    FMI2_EXPORT fmi2Status fmi2##function(__VA_ARGS__);                                                            \
    FMI2_EXPORT fmi2Status fmi2##function(__VA_ARGS__) {                                                           \
        NOT_PROVIDED(c, 1, "%s: the Python flavour is for co-simulation. Take the native FMU.", "fmi2" #function); \
    }
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wunused-parameter"
NO_EXCHANGE(EnterEventMode, fmi2Component c)
NO_EXCHANGE(EnterContinuousTimeMode, fmi2Component c)
NO_EXCHANGE(NewDiscreteStates, fmi2Component c, fmi2EventInfo *info)
NO_EXCHANGE(CompletedIntegratorStep, fmi2Component c, fmi2Boolean no_rollback, fmi2Boolean *enter,
            fmi2Boolean *terminate)
NO_EXCHANGE(SetTime, fmi2Component c, fmi2Real time)
NO_EXCHANGE(SetContinuousStates, fmi2Component c, const fmi2Real x[], size_t n)
NO_EXCHANGE(GetContinuousStates, fmi2Component c, fmi2Real x[], size_t n)
NO_EXCHANGE(GetDerivatives, fmi2Component c, fmi2Real derivatives[], size_t n)
NO_EXCHANGE(GetEventIndicators, fmi2Component c, fmi2Real indicators[], size_t n)
NO_EXCHANGE(GetNominalsOfContinuousStates, fmi2Component c, fmi2Real nominals[], size_t n)
#pragma clang diagnostic pop

/* ---- status of a step ---- */

FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
    NOT_PROVIDED(c, 1, SAY_NO_STEP_IN_PROGRESS, "fmi2CancelStep");
}

FMI2_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *instance = c;
    if (unusable(instance) || missing(instance, value, 1, "fmi2GetRealStatus")) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) {
        say(instance, fmi2Discard, SAY_ONLY_STATUS, "fmi2GetRealStatus", "fmi2LastSuccessfulTime");
        return fmi2Discard;
    }
    *value = instance->reached;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *instance = c;
    if (unusable(instance) || missing(instance, value, 1, "fmi2GetBooleanStatus")) return fmi2Error;
    if (kind != fmi2Terminated) {
        say(instance, fmi2Discard, SAY_ONLY_STATUS, "fmi2GetBooleanStatus", "fmi2Terminated");
        return fmi2Discard;
    }
    *value = fmi2False; /* the component never asks to end the simulation */
    return fmi2OK;
}

static fmi2Status no_status(Instance *instance, const char *function) {
    if (unusable(instance)) return fmi2Error;
    say(instance, fmi2Discard, SAY_NEVER_PENDING, function);
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
