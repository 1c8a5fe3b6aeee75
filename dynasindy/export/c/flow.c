
/* ---- Predictions by the model ---- */

@if pushed
/* Places of the rates on which a constant push acts. */
static const int pushed[N - NX] = {@pushed@};
@end
@if stops
static const int stop_position[@n_stops@] = {@stop_position@};
static const int stop_rate[@n_stops@] = {@stop_rate@};
static const double stop_low[@n_stops@] = {@stop_low@};
static const double stop_high[@n_stops@] = {@stop_high@};
@end

/* dx/dt of the states@pushes_word@. */
static void rates(const double x[N], const double u[NU], double dx[N])
{
@if pushed
    int i;
@end
    field(x, u, dx);
@if pushed
    for (i = 0; i < N - NX; i++) {
        dx[pushed[i]] += x[NX + i];
        dx[NX + i] = 0.0;
    }
@end
}

@if stops
/* A position at the end of its travel stays there, and a rate that leads further is zero. */
static void stop(double x[N])
{
    int i;
    for (i = 0; i < @n_stops@; i++) {
        double *position = &x[stop_position[i]], *rate = &x[stop_rate[i]];
        const int below = *position <= stop_low[i], above = *position >= stop_high[i];
        if (below)
            *position = stop_low[i];
        else if (above)
            *position = stop_high[i];
        if ((below && *rate < 0.0) || (above && *rate > 0.0))
            *rate = 0.0;
    }
}

@end
@if difference
/* Move states on under held inputs, by steps of the difference equation x + h f(x, u). */
@end
@if !difference
/* Move states on under held inputs, by steps of the classical Runge-Kutta method of fourth order. */
@end
static void flow(double x[N], const double u[NU], double h, int steps)
{
@if difference
    double k[N];
@end
@if !difference
    double k[N], sum[N], z[N];
@end
    int i, s;
    for (s = 0; s < steps; s++) {
        rates(x, u, k);
@if difference
        for (i = 0; i < N; i++)
            x[i] += h * k[i];
@end
@if !difference
        for (i = 0; i < N; i++) {
            sum[i] = k[i];
            z[i] = x[i] + 0.5 * h * k[i];
        }
        rates(z, u, k);
        for (i = 0; i < N; i++) {
            sum[i] += 2.0 * k[i];
            z[i] = x[i] + 0.5 * h * k[i];
        }
        rates(z, u, k);
        for (i = 0; i < N; i++) {
            sum[i] += 2.0 * k[i];
            z[i] = x[i] + h * k[i];
        }
        rates(z, u, k);
        for (i = 0; i < N; i++)
            x[i] += h / 6.0 * (sum[i] + k[i]);
@end
@if stops
        stop(x);
@end
    }
}
