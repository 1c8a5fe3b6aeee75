
EXPORT int fmi3SetDebugLogging(void *instance, bool on, size_t n, const char *const *categories)
{
    (void)instance, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool event_mode, bool early_return, const uint32_t *intermediate, size_t n, void *environment,
    void (*log)(void), void (*update)(void))
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)early_return, (void)intermediate;
    (void)environment, (void)log, (void)update;
    return made(token, !event_mode && !n);
}

EXPORT int fmi3EnterInitializationMode(void *instance, bool has_tolerance, double tolerance, double start,
    bool has_stop, double stop_time)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((component *)instance)->start = start;
    return OK;
}

EXPORT int fmi3GetFloat64(void *instance, const reference *places, size_t n, double *values, size_t n_values)
{
    return n == n_values ? exchanged((component *)instance, places, n, values, NULL) : ERROR;
}

EXPORT int fmi3SetFloat64(void *instance, const reference *places, size_t n, const double *values, size_t n_values)
{
    return n == n_values ? exchanged((component *)instance, places, n, NULL, values) : ERROR;
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

#define NOTHING(name) \
    EXPORT void *name(void *instance) \
    { \
        (void)instance; \
        return NULL; \
    }
NOTHING(fmi3InstantiateModelExchange)
NOTHING(fmi3InstantiateScheduledExecution)
