/* The probe, but it ends its process while it is initialized, as gain says: 2 crash, 3 exit, 4 never ends. */
#include <signal.h>
#include <stdlib.h>
#include "fmi2Functions.h"
#undef fmi2EnterInitializationMode
#define fmi2EnterInitializationMode probe_enter
#include "probe.c"
#undef fmi2EnterInitializationMode

FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Probe *p = (Probe *)c;
    volatile int forever = 1;
    if (p->r[GAIN] == 2.0) raise(SIGSEGV);
    if (p->r[GAIN] == 3.0) exit(5);
    while (p->r[GAIN] == 4.0 && forever) {
    }
    return probe_enter(c);
}
