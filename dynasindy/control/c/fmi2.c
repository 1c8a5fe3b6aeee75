
EXPORT const char *fmi2GetTypesPlatform(void)
{
    return "default";
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources,
    const void *callbacks, int visible, int logging)
{
    (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
    return made(token, type == 1);
}

EXPORT int fmi2SetupExperiment(void *instance, int has_tolerance, double tolerance, double start, int has_stop,
    double stop_time)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((component *)instance)->start = start;
    return OK;
}

EXPORT int fmi2GetReal(void *instance, const reference *places, size_t n, double *values)
{
    return exchanged((component *)instance, places, n, values, NULL);
}

EXPORT int fmi2SetReal(void *instance, const reference *places, size_t n, const double *values)
{
    return exchanged((component *)instance, places, n, NULL, values);
}

EXPORT int fmi2DoStep(void *instance, double now, double h, int no_return)
{
    (void)no_return;
    return h > 0.0 && step((component *)instance, now, h) ? OK : ERROR;
}
