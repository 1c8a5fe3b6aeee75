
/* ---- The controller ---- */

@if integral
/* I += gain dt e where e is a steady error: none beyond the band, and of one that moves less. */
static void integrate(@name@_state *s, const double x[NX], const double r[NR], const double rate[NR])
{
    int i;
    for (i = 0; i < NR; i++) {
        const double error = (r[i] - x[output[i]]) / box[i];
        const double moving = output_rate[i] < 0 ? 0.0 : (rate[i] - x[output_rate[i]]) / box[i] / @integral_rate@;
        if (fabs(error) < @integral_band@)
            s->integral[i] += @integral_gain@ * @dt@ * error / (1.0 + moving * moving);
        if (s->integral[i] > @integral_limit@)
            s->integral[i] = @integral_limit@;
        else if (s->integral[i] < -@integral_limit@)
            s->integral[i] = -@integral_limit@;
    }
}

@end
void @name@_reset(@name@_state *s)
{
    const @name@_state nothing = {0};
    *s = nothing;
}

int @name@_act(@name@_state *s, const double y[NX], const double r[NR], const double rate[NR], double u[NU])
{
    const @name@_state before = *s;
    const double *kept = (const double *)s; /* all of it is of this type */
    double x[N], slope[NR], found[NU];
    int i, fine = 1;
    for (i = 0; i < NR; i++) {
        slope[i] = rate ? rate[i] : 0.0;
        fine = fine && isfinite(r[i]) && isfinite(slope[i]);
    }
@if observer
    for (i = 0; i < M; i++)
        fine = fine && !isinf(y[sensed[i]]);
@end
@if !observer
    for (i = 0; i < NX; i++) {
        x[i] = y[i];
        fine = fine && isfinite(x[i]);
    }
@end
    for (i = 0; i < NU; i++)
        u[i] = s->u[i];
    if (!fine)
        return @name@_REFUSED;
@if observer
    if (s->begun > 0.0) {
        advance(s);
        fine = correct(s, y);
    } else
        begin(s, y);
    s->begun = 1.0;
    ahead(s, x);
@end
@if pushed
    counteract(s, x);
    for (i = 0; i < NX; i++)
        x[i] -= s->shift[i];
@end
    policy(@give_state@x, r, @give_rate@found);
@if integral
    integrate(s, x, r, slope);
@end
    for (i = 0; i < NU; i++) {
@if pushed
        found[i] += s->shift[NX + i];
@end
        if (found[i] > most[i])
            found[i] = most[i];
        else if (found[i] < least[i])
            found[i] = least[i];
        fine = fine && isfinite(found[i]);
    }
    for (i = 0; i < (int)(sizeof *s / sizeof *kept); i++)
        fine = fine && isfinite(kept[i]);
    if (!fine) {
        *s = before;
        return @name@_REFUSED;
    }
    for (i = 0; i < NU; i++)
        u[i] = s->u[i] = found[i];
@if observer
    for (i = 0; i < MEMORY * NU; i++)
        s->inputs[i / NU][i % NU] = i / NU == MEMORY - 1 ? u[i % NU] : s->inputs[i / NU + 1][i % NU];
@end
    return @name@_OK;
}
