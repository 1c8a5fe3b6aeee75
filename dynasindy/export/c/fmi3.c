
/* ---- FMI 3.0, co-simulation; value references are the places in `values`, plus 1: 0 is the time ---- */

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, ERROR = 3 };

EXPORT const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORT int fmi3SetDebugLogging(void *instance, bool on, size_t n, const char *const *categories)
{
    (void)instance, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool event_mode, bool early_return, const uint32_t *intermediate, size_t n, void *environment,
    void (*log)(void), void (*update)(void))
{
    component *c;
    (void)name, (void)resources, (void)visible, (void)logging, (void)early_return, (void)intermediate;
    (void)environment, (void)log, (void)update;
    if (!token || strcmp(token, "@token@") != 0 || event_mode || n)
        return NULL;
    c = (component *)malloc(sizeof *c);
    if (c)
        begin(c);
    return c;
}

EXPORT void fmi3FreeInstance(void *instance)
{
    free(instance);
}

EXPORT int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start,
    bool has_stop, double stop_time)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((component *)instance)->start = start;
    return OK;
}

EXPORT int fmi3Reset(void *instance)
{
    begin((component *)instance);
    return OK;
}

EXPORT int fmi3GetFloat64(void *instance, const uint32_t *places, size_t n, double *values, size_t n_values)
{
    size_t i;
    if (n != n_values)
        return ERROR;
    for (i = 0; i < n; i++) {
        if (places[i] < 1 || places[i] > VALUES)
            return ERROR;
        values[i] = ((component *)instance)->values[places[i] - 1];
    }
    return OK;
}

EXPORT int fmi3SetFloat64(void *instance, const uint32_t *places, size_t n, const double *values, size_t n_values)
{
    size_t i;
    if (n != n_values)
        return ERROR;
    for (i = 0; i < n; i++) {
        if (places[i] < 1 || places[i] > VALUES)
            return ERROR;
        ((component *)instance)->values[places[i] - 1] = values[i];
    }
    return OK;
}

EXPORT int fmi3DoStep(void *instance, double now, double h, bool no_return, bool *event, bool *terminate, bool *early,
    double *reached)
{
    (void)no_return;
    *event = *terminate = *early = false;
    *reached = now;
    if (!(h > 0.0) || !step((component *)instance, now, h))
        return ERROR;
    *reached = now + h;
    return OK;
}

EXPORT int fmi3GetFMUState(void *instance, void **kept)
{
    if (!*kept)
        *kept = malloc(sizeof(component));
    if (!*kept)
        return ERROR;
    memcpy(*kept, instance, sizeof(component));
    return OK;
}

EXPORT int fmi3SetFMUState(void *instance, void *kept)
{
    memcpy(instance, kept, sizeof(component));
    return OK;
}

EXPORT int fmi3FreeFMUState(void *instance, void **kept)
{
    (void)instance;
    free(*kept);
    *kept = NULL;
    return OK;
}

/* What changes no more, and what this FMU has not; arguments behind the instance are not read. */
#define ANSWER(name, status) \
    EXPORT int name(void *instance) \
    { \
        (void)instance; \
        return status; \
    }
#define NOTHING(name) \
    EXPORT void *name(void *instance) \
    { \
        (void)instance; \
        return NULL; \
    }
NOTHING(fmi3InstantiateModelExchange)
NOTHING(fmi3InstantiateScheduledExecution)
@answers@
