/* The probe, but it misbehaves as its parameter label says: in the step that begins at fail_time or later, or in the
 * call that the label names.
 */
#define _GNU_SOURCE
#include <fenv.h>
#include <locale.h>
#include <pthread.h>
#include <signal.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "fmi2Functions.h"
#undef fmi2DoStep
#undef fmi2EnterInitializationMode
#undef fmi2FreeInstance
#define fmi2DoStep probe_do_step
#define fmi2EnterInitializationMode probe_enter_initialization
#define fmi2FreeInstance probe_free
#include "probe.c"
#undef fmi2DoStep
#undef fmi2EnterInitializationMode
#undef fmi2FreeInstance

static volatile int *volatile nowhere = 0;
static volatile int counter;

static void hang(void) {
    for (;;) counter++;
}

static int overflow(int depth) {
    volatile char large[65536];
    large[0] = (char)depth;
    return overflow(depth + 1) + large[0];
}

static void *tick(void *nothing) {
    for (;;) {
        usleep(1000);
        counter++;
    }
    return nothing;
}

static void *leave(void *nothing) {
    usleep(1000);
    exit(5);
    return nothing;
}

static void start(void *(*run)(void *)) {
    pthread_t thread;
    pthread_create(&thread, NULL, run, NULL);
}

static void log_text(Probe *p, fmi2Status status, const char *text) {
    p->callbacks.logger(p->callbacks.componentEnvironment, p->name, status, "logStatusWarning", text);
}

static void misbehave(Probe *p) {
    const char *how = p->label;
    if (!strcmp(how, "segv")) *nowhere = 1;
    if (!strcmp(how, "abort")) abort();
    if (!strcmp(how, "stack")) counter = overflow(0);
    if (!strcmp(how, "trap")) __builtin_trap();
    if (!strcmp(how, "exit 0")) exit(0);
    if (!strcmp(how, "exit 3")) exit(3);
    if (!strcmp(how, "_exit")) _exit(0);
    if (!strcmp(how, "kill")) kill(getpid(), SIGKILL);
    if (!strcmp(how, "alarm")) {
        alarm(1);
        hang();
    }
    if (!strcmp(how, "hang")) hang();
    if (!strcmp(how, "sleep")) sleep(600);
    if (!strcmp(how, "deaf")) {
        for (int number = 1; number < 32; number++) signal(number, SIG_IGN);
        hang();
    }
    if (!strcmp(how, "chdir") && chdir("/")) abort();
    if (!strcmp(how, "temporary folder")) {
        char name[4096];
        snprintf(name, sizeof name, "%s/left-XXXXXX", getenv("TMPDIR"));
        if (mkdtemp(name)) *nowhere = 1;
    }
    if (!strcmp(how, "close"))
        for (int number = 0; number < 128; number++) close(number);
    if (!strcmp(how, "close all"))
        for (int number = 0; number < 4096; number++) close(number);
    if (!strcmp(how, "rounding")) fesetround(FE_UPWARD);
    if (!strcmp(how, "locale")) setlocale(LC_ALL, "");
    if (!strcmp(how, "fork") && fork() == 0) {
        sleep(600);
        _exit(0);
    }
    if (!strcmp(how, "daemon") && fork() == 0) {
        setsid();
        prctl(PR_SET_NAME, "cosim-stray");
        sleep(600);
        _exit(0);
    }
    if (!strcmp(how, "background")) {
        prctl(PR_SET_NAME, "cosim-stray");
        if (daemon(1, 0)) abort();
        hang();
    }
    if (!strcmp(how, "write all"))
        for (int number = 0; number < 4096; number++)
            if (write(number, "What an FMU writes where it has no business to.", 47) < 0) continue;
    if (!strcmp(how, "print")) {
        fprintf(stderr, "to stderr \x1b[2J\n");
        for (int line = 0; line < 20000; line++) printf("line %d\n", line);
        for (int i = 0; i < 1 << 20; i++) putchar('x');
        fflush(stdout);
    }
    if (!strcmp(how, "storm")) {
        for (int i = 0; i < 20000; i++) log_text(p, fmi2OK, "all is well");
        log_text(p, fmi2Warning, "the one that matters");
    }
    if (!strcmp(how, "huge")) {
        const size_t length = (size_t)10 << 20;
        char *text = malloc(length + 1);
        memset(text, 'm', length);
        text[length] = 0;
        log_text(p, fmi2Warning, text);
        free(text);
    }
    if (!strcmp(how, "escape")) log_text(p, fmi2Warning, "\xff\xfe\x1b[2J\x1b]0;title\x07 [bold]rich[/] [/nope]");
}

FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Probe *p = c;
    if (!strcmp(p->label, "segv in initialization")) *nowhere = 1;
    if (!strcmp(p->label, "hang in initialization")) hang();
    if (!strcmp(p->label, "thread")) start(tick);
    if (!strcmp(p->label, "thread that exits")) start(leave);
    return probe_enter_initialization(c);
}

FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_set) {
    Probe *p = c;
    if (t >= p->r[FAIL_TIME] - 1e-9 && t < p->r[FAIL_TIME] + h - 1e-9) misbehave(p);
    const double fail_time = p->r[FAIL_TIME];
    p->r[FAIL_TIME] = INFINITY;
    const fmi2Status status = probe_do_step(c, t, h, no_set);
    p->r[FAIL_TIME] = fail_time;
    return status;
}

FMI2_Export void fmi2FreeInstance(fmi2Component c) {
    Probe *p = c;
    if (!strcmp(p->label, "segv while freed")) *nowhere = 1;
    if (!strcmp(p->label, "hang while freed")) hang();
    probe_free(c);
}
