
/* ---- The observer: an extended Kalman filter on the model ---- */

/* of the central differences */
static const double step[N] = {@step@};
/* Q: variance by which a state leaves the model in a period */
static const double strays[N] = {@strays@};
/* variance of what is not measured when it begins, and by which a state is doubted */
static const double unknown[N] = {@unknown@};
/* places of the states that are measured */
static const int sensed[M] = {@sensed@};
/* R: variance of their measurements */
static const double variance[M] = {@variance@};
/* least variance of which the bound of an innovation is a multiple */
static const double narrowest[M] = {@narrowest@};
/* Move states on by the period whose measurement has just arrived; inputs act @late_words@ later. */
static void period(double x[N], double inputs[MEMORY][NU])
{
@if part
    flow(x, inputs[MEMORY - LATE - 2], @part@ / @part_steps@, @part_steps@);
@end
    flow(x, inputs[MEMORY - LATE - 1], @rest@ / @rest_steps@, @rest_steps@);
}

/* x = the estimate at rest from the first measurement, P = diag of its variances. */
static void begin(@name@_state *s, const double y[NX])
{
    int i, j;
    for (i = 0; i < N; i++) {
        s->x[i] = 0.0;
        for (j = 0; j < N; j++)
            s->p[i][j] = 0.0;
        s->p[i][i] = unknown[i];
    }
    for (i = 0; i < M; i++)
        if (y[sensed[i]] * y[sensed[i]] <= @far@ * unknown[sensed[i]]) {
            s->x[sensed[i]] = y[sensed[i]];
            s->p[sensed[i]][sensed[i]] = variance[i];
        }
@if followers
@followers@ /* it follows that state, and is equal to it at rest */
@end
}

/* x+ = f(x, u), P+ = F P F' + Q, with F = dx+/dx by central differences. */
static void advance(@name@_state *s)
{
    double f[N][N], p[N][N], mean[N], forth[N], back[N];
    int i, j, k, sound = 1;
    for (i = 0; i < N; i++)
        mean[i] = s->x[i];
    period(mean, s->inputs);
    for (j = 0; j < N; j++) {
        for (i = 0; i < N; i++)
            forth[i] = back[i] = s->x[i];
        forth[j] += step[j];
        back[j] -= step[j];
        period(forth, s->inputs);
        period(back, s->inputs);
        for (i = 0; i < N; i++)
            f[i][j] = (forth[i] - back[i]) / (2.0 * step[j]);
    }
    for (i = 0; i < N; i++) {
        sound = sound && isfinite(mean[i]);
        for (j = 0; j < N; j++) { /* F P, its row i in forth; then times F' */
            forth[j] = 0.0;
            for (k = 0; k < N; k++)
                forth[j] += f[i][k] * s->p[k][j];
        }
        for (j = 0; j < N; j++) {
            p[i][j] = i == j ? strays[i] : 0.0;
            for (k = 0; k < N; k++)
                p[i][j] += forth[k] * f[j][k];
            sound = sound && isfinite(p[i][j]);
        }
    }
    if (!sound) { /* A model that explodes is no ground to lose an estimate; it is doubted instead. */
        for (i = 0; i < N; i++)
            s->p[i][i] += unknown[i];
        return;
    }
    for (i = 0; i < N; i++) {
        s->x[i] = mean[i];
        for (j = 0; j < N; j++)
            s->p[i][j] = p[i][j];
    }
}

/* K = P C' (C P C' + R)^-1, x += K (y - C x), P = (I - K C) P (I - K C)' + K R K'; C picks what was measured. What no
 * plant can do counts as lost, and that state is doubted. Returns 0 where there is no K. */
static int correct(@name@_state *s, const double y[NX])
{
    double spread[M][M], gain[M][N], left[N][N], innovation[M], r[M]; /* the gain transposed */
    int seen[M], i, j, k;
    for (i = 0; i < M; i++) {
        const double own = s->p[sensed[i]][sensed[i]] + variance[i];
        innovation[i] = y[sensed[i]] - s->x[sensed[i]];
        seen[i] = innovation[i] * innovation[i] <= @far@ * (own < narrowest[i] ? narrowest[i] : own);
        if (!seen[i])
            innovation[i] = 0.0;
    }
    for (i = 0; i < M; i++) {
        r[i] = seen[i] ? variance[i] : 0.0;
        for (j = 0; j < N; j++)
            gain[i][j] = seen[i] ? s->p[j][sensed[i]] : 0.0;
        for (j = 0; j < M; j++)
            spread[i][j] = seen[i] && seen[j] ? s->p[sensed[i]][sensed[j]] : 0.0;
        spread[i][i] += seen[i] ? variance[i] : 1.0;
    }
    if (!solve(&spread[0][0], &gain[0][0], M, N))
        return 0;
    for (i = 0; i < N; i++)
        for (j = 0; j < N; j++) {
            left[i][j] = s->p[i][j];
            for (k = 0; k < M; k++)
                left[i][j] -= gain[k][i] * s->p[sensed[k]][j];
        }
    for (i = 0; i < N; i++) {
        for (j = 0; j < N; j++) {
            s->p[i][j] = left[i][j];
            for (k = 0; k < M; k++)
                s->p[i][j] += gain[k][j] * (gain[k][i] * r[k] - left[i][sensed[k]]);
        }
        for (k = 0; k < M; k++)
            s->x[i] += gain[k][i] * innovation[k];
    }
    for (i = 0; i < M; i++)
        if (!seen[i] && isfinite(y[sensed[i]]))
            s->p[sensed[i]][sensed[i]] += unknown[sensed[i]];
    return 1;
}

/* Predict the state at the time at which the next input arrives at the plant. */
static void ahead(@name@_state *s, double x[N])
{
    int i@late_index@;
    for (i = 0; i < N; i++)
        x[i] = s->x[i];
@if part
    flow(x, s->inputs[MEMORY - LATE - 1], @part@ / @part_steps@, @part_steps@);
@end
@if late
    for (k = LATE; k > 0; k--)
        flow(x, s->inputs[MEMORY - k], @dt@ / @substeps@, @substeps@);
@end
    for (i = 0; i < N; i++)
        if (!isfinite(x[i]))
            x[i] = s->x[i];
}
