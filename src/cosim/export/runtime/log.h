/* Which messages an importer wants, as bits of log categories; included after contract.h. */
#ifndef LOG_H
#define LOG_H

#include <string.h>

#define EVERY_CATEGORY ~0u
/* With logging off, FMI lets an importer suppress debug messages, but not errors. */
#define ONLY_ERRORS (1u << LOG_ERROR)

/* The category of the messages with a status. */
static unsigned category_of(int status) {
    return status == WARNING ? LOG_WARNING : status == DISCARD ? LOG_DISCARD : LOG_ERROR;
}

static int is_wanted(unsigned categories, unsigned category) {
    return (categories & (1u << category | 1u << LOG_ALL)) != 0;
}

/* The bit of a named category, 0 if there is no category of that name. */
static unsigned category_bit(const char *name) {
    for (unsigned k = 0; name && k < N_CATEGORIES; k++)
        if (strcmp(name, category_names[k]) == 0) return 1u << k;
    return 0;
}

#endif
