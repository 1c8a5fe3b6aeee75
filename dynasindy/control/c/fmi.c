
/* ---- FMI {{ version }}.0, co-simulation; value references are the places in `values`, plus 1 ---- */

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, ERROR = 3 };
typedef {{ reference }} reference;

static void *made(const char *token, int allowed)
{
    component *c;
    if (!token || strcmp(token, "{{ token }}") != 0 || !allowed)
        return NULL;
    c = (component *)malloc(sizeof *c);
    if (c)
        begin(c);
    return c;
}

/* Values are told where there is room for them, else taken. */
static int exchanged(component *c, const reference *places, size_t n, double *told, const double *taken)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (places[i] < 1 || places[i] > VALUES)
            return ERROR;
        if (told)
            told[i] = c->values[places[i] - 1];
        else
            c->values[places[i] - 1] = taken[i];
    }
    return OK;
}

EXPORT const char *fmi{{ version }}GetVersion(void)
{
    return "{{ version }}.0";
}

EXPORT void fmi{{ version }}FreeInstance(void *instance)
{
    free(instance);
}

EXPORT int fmi{{ version }}Reset(void *instance)
{
    begin((component *)instance);
    return OK;
}

/* What changes no more, and what this FMU has not; arguments behind the instance are not read. */
#define ANSWER(name, status) \
    EXPORT int name(void *instance) \
    { \
        (void)instance; \
        return status; \
    }
{{ answers }}
