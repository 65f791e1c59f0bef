/* Random calls of an FMU with random arguments: whatever an importer does, it gets a status.
   Compiled with the FMU's model.c (-I its sources) and a sanitizer; the arguments are the number of runs and a seed. */
#include "model.c"

enum { CALLS = 200, ROOM = 600 };

static unsigned long long state;

static unsigned pick(unsigned n) { /* 0 ... n - 1 */
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (unsigned)(state >> 33) % n;
}

static double number(void) {
    static const double odd[] = {NAN, INFINITY, -1e300, 0.0, 1e-3, 1e-5};
    const unsigned i = pick(9);
    return i < 6 ? odd[i] : (double)pick(2000000) / 1e6 - 1.0;
}

/* Spoil a serialized state: one bit anywhere, or several that the checksum does not give away. */
static void spoil(void *bytes) {
    unsigned char *content = bytes;
    const unsigned turns = pick(2) ? 1 : 1 + pick(20);
    for (unsigned i = 0; i < turns; i++) content[pick(sizeof(Saved))] ^= (unsigned char)(1u << pick(8));
    if (turns > 1 || pick(2)) {
        Saved sealed;
        memcpy(&sealed, bytes, sizeof sealed);
        if (pick(4)) {
            memcpy(sealed.guid, MODEL_GUID, sizeof MODEL_GUID);
            sealed.version = STATE_VERSION;
            sealed.size = sizeof sealed;
        }
        sealed.checksum = checksum(&sealed);
        memcpy(bytes, &sealed, sizeof sealed);
    }
}

/* The number of runs; seeds the numbers. */
static long runs_of(int count, char **arguments) {
    state = count > 2 ? (unsigned long long)atol(arguments[2]) : 1;
    return count > 1 ? atol(arguments[1]) : 100;
}
