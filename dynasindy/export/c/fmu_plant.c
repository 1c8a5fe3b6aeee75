
typedef struct {
    double values[VALUES]; /* inputs, then states */
    double start;
@if late
    struct {
        double since;
        double u[NU];
    } past[PAST]; /* inputs that have not acted yet, and the one that acts now */
    int n_past;
@end
} component;

static void begin(component *c)
{
    int i;
    for (i = 0; i < VALUES; i++)
        c->values[i] = 0.0;
    c->start = 0.0;
@if late
    c->n_past = 0;
@end
}

@if difference
/* Move on under held inputs, by steps of @step@ s. */
@end
@if !difference
/* Move on under held inputs, by steps of at most @step@ s. */
@end
static void move(double x[NX], const double u[NU], double seconds)
{
    const double steps = ceil(seconds / @step@ - 1e-6);
    const int n = steps < 1.0 ? 1 : (int)steps;
@if difference
    flow(x, u, @step@, n);
@end
@if !difference
    flow(x, u, seconds / n, n);
@end
}

/* Move the plant from now to now + h. */
static bool step(component *c, double now, double h)
{
    double *x = c->values + NU;
@if difference
    if (h < 0.5 * @step@ || fabs(h / @step@ - floor(h / @step@ + 0.5)) > 1e-6)
        return false; /* the model says nothing of the time between its steps */
@end
@if !late
    (void)now;
    move(x, c->values, h);
@end
@if late
    const double nothing[NU] = {0.0}, end = now + h, near = 1e-9 * (fabs(end) + @delay@);
    int i, k;
    while (c->n_past > 1 && c->past[1].since + @delay@ <= now + near) {
        for (k = 1; k < c->n_past; k++)
            c->past[k - 1] = c->past[k];
        c->n_past--;
    }
    if (c->n_past == PAST)
        return false;
    c->past[c->n_past].since = now;
    for (i = 0; i < NU; i++)
        c->past[c->n_past].u[i] = c->values[i];
    c->n_past++;
    while (now < end - near) {
        const double *u = nothing;
        double until = end;
        for (k = 0; k < c->n_past; k++)
            if (c->past[k].since + @delay@ <= now + near)
                u = c->past[k].u;
            else if (c->past[k].since + @delay@ < until)
                until = c->past[k].since + @delay@;
        move(x, u, until - now);
        now = until;
    }
@end
    return true;
}
