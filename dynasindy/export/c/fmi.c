
/* ---- FMI {{ version }}.0, co-simulation; value references are the places in `values`, plus 1 ---- */

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK = 0, ERROR = 3 };
typedef {{ "unsigned int" if version == 2 else "uint32_t" }} reference;

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

@ if version == 2
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

EXPORT int fmi2DoStep(void *instance, double now, double h, int no_return)
{
    (void)no_return;
    return h > 0.0 && step((component *)instance, now, h) ? OK : ERROR;
}

@ else
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
    bool logging, bool event_mode, bool early_return, const uint32_t *intermediate, size_t n, void *environment,
    void (*log)(void), void (*update)(void))
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)early_return, (void)intermediate;
    (void)environment, (void)log, (void)update;
    return made(token, !event_mode && !n);
}

EXPORT int fmi3DoStep(void *instance, double now, double h, bool no_return, bool *event, bool *terminate, bool *early,
    double *reached)
{
    const int fine = h > 0.0 && step((component *)instance, now, h);
    (void)no_return;
    *event = *terminate = *early = false;
    *reached = fine ? now + h : now;
    return fine ? OK : ERROR;
}

@ endif
@ set flag, number = ("int", "Real") if version == 2 else ("bool", "Float64")
EXPORT int fmi{{ version }}{{ "SetupExperiment" if version == 2 else "EnterInitializationMode" }}(void *instance,
    {{ flag }} has_tolerance, double tolerance, double start, {{ flag }} has_stop, double stop_time)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop_time;
    ((component *)instance)->start = start;
    return OK;
}

@ for way, kind, told, taken in (("Get", "double", "values", "NULL"), ("Set", "const double", "NULL", "values"))
EXPORT int fmi{{ version }}{{ way }}{{ number }}(void *instance, const reference *places, size_t n,
    {{ kind }} *values{{ "" if version == 2 else ", size_t n_values" }})
{
@ if version == 3
    if (n != n_values)
        return ERROR;
@ endif
    return exchanged((component *)instance, places, n, {{ told }}, {{ taken }});
}

@ endfor
/* What changes no more, and what this FMU has not; arguments behind the instance are not read. */
#define ANSWER(name, status) \
    EXPORT int name(void *instance) \
    { \
        (void)instance; \
        return status; \
    }
@ for name in fine
ANSWER(fmi{{ version }}{{ name }}, OK)
@ endfor
@ for name in absent
ANSWER(fmi{{ version }}{{ name }}, ERROR)
@ endfor
@ if version == 3

#define NOTHING(name) \
    EXPORT void *name(void *instance) \
    { \
        (void)instance; \
        return NULL; \
    }
NOTHING(fmi3InstantiateModelExchange)
NOTHING(fmi3InstantiateScheduledExecution)
@ endif
