/* The controller as an FMU: at every multiple of its period it reads its inputs and sets its outputs. */
#include "{{ name }}.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { INPUTS = {{ inputs }}, VALUES = {{ values }}, M = {{ measured | length }} };

/* Places of the measured states. */
static const int measured[M] = { {{- measured | join(", ") -}} };

typedef struct {
    double values[VALUES]; /* measurements, references, their rates, then the inputs of the plant */
    double start;
    long periods;
    {{ name }}_state state;
} component;

static void begin(component *c)
{
    memset(c, 0, sizeof *c);
    {{ name }}_reset(&c->state);
}

/* Act at the multiples of the period from now to before now + h. */
static bool step(component *c, double now, double h)
{
    double y[{{ name }}_NX];
    int i;
    for (i = 0; i < {{ name }}_NX; i++)
        y[i] = NAN;
    for (i = 0; i < M; i++)
        y[measured[i]] = c->values[i];
    while (c->start + (double)c->periods * {{ dt }} < now + h - 1e-6 * {{ dt }}) {
        if ({{ name }}_act(&c->state, y, c->values + M, c->values + M + {{ name }}_NR, c->values + INPUTS) != {{ name }}_OK)
            return false;
        c->periods++;
    }
    return true;
}
