/* The plant as its model knows it, as an FMU. */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { NX = {{ model.signature.n_x }}, NU = {{ model.signature.n_u }}, N = NX, VALUES = NX + NU, PAST = {{ past if model.delay else 2 }} };

{% include "flow.c" %}
typedef struct {
    double values[VALUES]; /* inputs, then states */
    double start;
    struct {
        double since;
        double u[NU];
    } past[PAST]; /* inputs that have not acted yet, and the one that acts now */
    int n_past;
} component;

static void begin(component *c)
{
    memset(c, 0, sizeof *c);
}

@ if model.step is none
/* Move on under held inputs, by steps of at most {{ step }} s. */
@ else
/* Move on under held inputs, by steps of {{ step }} s. */
@ endif
static void move(double x[NX], const double u[NU], double seconds)
{
    const int n = (int)fmax(1.0, ceil(seconds / {{ step }} - 1e-6));
    flow(x, u, {{ "seconds / n" if model.step is none else step }}, n);
}

/* Move the plant from now to now + h. */
static bool step(component *c, double now, double h)
{
    const double nothing[NU] = {0.0}, end = now + h, near = fmin(1e-6 * h, 1e-9 * (fabs(end) + {{ delay }}));
    int k;
@ if model.step is not none
    if (h < 0.5 * {{ step }} || fabs(h / {{ step }} - floor(h / {{ step }} + 0.5)) > 1e-6)
        return false; /* the model says nothing of the time between its steps */
@ endif
    while (c->n_past > 1 && c->past[1].since + {{ delay }} <= now + near)
        memmove(c->past, c->past + 1, (size_t)--c->n_past * sizeof *c->past);
    if (c->n_past == PAST)
        return false;
    c->past[c->n_past].since = now;
    memcpy(c->past[c->n_past++].u, c->values, sizeof nothing);
    while (now < end - near) {
        const double *u = nothing;
        double until = end;
        for (k = 0; k < c->n_past; k++)
            if (c->past[k].since + {{ delay }} <= now + near)
                u = c->past[k].u;
            else if (c->past[k].since + {{ delay }} < until)
                until = c->past[k].since + {{ delay }};
        move(c->values + NU, u, until - now);
        now = until;
    }
    return true;
}
