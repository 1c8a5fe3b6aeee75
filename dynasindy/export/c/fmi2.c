
/* ---- FMI 2.0, co-simulation; value references are the places in `values`, plus 1 ---- */

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, ERROR = 3 };

EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT const char *fmi2GetVersion(void)
{
    return "2.0";
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
    const void *callbacks, int visible, int logging)
{
    component *c;
    (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
    if (!token || strcmp(token, "@token@") != 0 || type != 1)
        return NULL;
    c = (component *)malloc(sizeof *c);
    if (c)
        begin(c);
    return c;
}

EXPORT void fmi2FreeInstance(void *instance)
{
    free(instance);
}

EXPORT int fmi2SetupExperiment(void *instance, int has_tolerance, double tolerance, double start, int has_stop,
    double stop_time)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((component *)instance)->start = start;
    return OK;
}

EXPORT int fmi2Reset(void *instance)
{
    begin((component *)instance);
    return OK;
}

EXPORT int fmi2GetReal(void *instance, const unsigned int *places, size_t n, double *values)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (places[i] < 1 || places[i] > VALUES)
            return ERROR;
        values[i] = ((component *)instance)->values[places[i] - 1];
    }
    return OK;
}

EXPORT int fmi2SetReal(void *instance, const unsigned int *places, size_t n, const double *values)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (places[i] < 1 || places[i] > VALUES)
            return ERROR;
        ((component *)instance)->values[places[i] - 1] = values[i];
    }
    return OK;
}

EXPORT int fmi2DoStep(void *instance, double now, double h, int no_return)
{
    (void)no_return;
    return h > 0.0 && step((component *)instance, now, h) ? OK : ERROR;
}

/* What changes no more, and what this FMU has not; arguments behind the instance are not read. */
#define ANSWER(name, status) \
    EXPORT int name(void *instance) \
    { \
        (void)instance; \
        return status; \
    }
@answers@
