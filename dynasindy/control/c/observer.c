/* ---- The observer: an extended Kalman filter on the model{{ ", and on constant pushes behind its states" if pushed else "" }} ---- */

/* of the central differences */
static const double step[N] = { {{- (nudge * size) | numbers -}} };
/* Q: variance by which a state leaves the model in a period */
static const double strays[N] = { {{- strays | numbers -}} };
/* variance of what is not measured when it begins, and by which a state is doubted */
static const double unknown[N] = { {{- unknown | numbers -}} };
/* estimates that no plant has are beyond it */
static const double farthest[N] = { {{- (far * size) | numbers -}} };
/* places of the states that are measured */
static const int sensed[M] = { {{- sensed | join(", ") -}} };
/* R: variance of their measurements */
static const double variance[M] = { {{- observer.variance[sensed] | numbers -}} };
/* least variance of which the bound of an innovation is a multiple */
static const double narrowest[M] = { {{- narrowest | numbers -}} };

/* x = the estimate at rest from the first measurement, P = diag of its variances. */
static void begin({{ name }}_state *s, const double y[NX])
{
    int i;
    memset(s->x, 0, sizeof s->x);
    memset(s->p, 0, sizeof s->p);
    for (i = 0; i < N; i++)
        s->p[i][i] = unknown[i];
    for (i = 0; i < M; i++)
        if (y[sensed[i]] * y[sensed[i]] <= {{ (far * far) | number }} * unknown[sensed[i]]) {
            s->x[sensed[i]] = y[sensed[i]];
            s->p[sensed[i]][sensed[i]] = variance[i];
        }
@ for follower, state in model.followers.items()
    s->x[{{ follower }}] = s->x[{{ state }}]; /* it follows that state, and is equal to it at rest */
@ endfor
}

/* Move states on by the period whose measurement has just arrived. */
static void period(double x[N], double inputs[MEMORY][NU])
{
@ for age, seconds, steps in observer.passages()[0]
    flow(x, inputs[MEMORY - {{ age }}], {{ (seconds / steps) | number }}, {{ steps }});
@ endfor
}

/* x+ = f(x, u), P+ = F P F' + Q, with F = dx+/dx by central differences. */
static void advance({{ name }}_state *s)
{
    double f[N][N], p[N][N], mean[N], forth[N], back[N];
    int i, j, k, sound = 1;
    memcpy(mean, s->x, sizeof mean);
    period(mean, s->inputs);
    for (j = 0; j < N; j++) {
        memcpy(forth, s->x, sizeof forth);
        memcpy(back, s->x, sizeof back);
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
    if (sound) {
        memcpy(s->x, mean, sizeof mean);
        for (i = 0; i < N; i++)
            memcpy(s->p[i], p[i], sizeof p[i]);
    } else /* A model that explodes is no ground to lose an estimate; it is doubted instead. */
        for (i = 0; i < N; i++)
            s->p[i][i] += unknown[i];
}

/* K = P C' / (C P C' + R), x += K (y - C x), P = (I - K C) P (I - K C)' + K R K' for one sensor after the other, as
 * their errors are independent; C picks its state. What no plant can do counts as lost, and that state is doubted; of
 * an estimate that no plant has all begins anew. */
static void correct({{ name }}_state *s, const double y[NX])
{
    double gain[N], row[N];
    int seen[M], confirmed[N] = { 0 }, i, j, k, sound = 1;
    for (i = 0; i < M; i++) {
        const double off = y[sensed[i]] - s->x[sensed[i]], own = s->p[sensed[i]][sensed[i]] + variance[i];
        confirmed[sensed[i]] = seen[i] = off * off <= {{ (far * far) | number }} * (own < narrowest[i] ? narrowest[i] : own);
    }
    for (i = 0; i < M; i++) {
        const int c = sensed[i];
        const double off = y[c] - s->x[c], spread = s->p[c][c] + variance[i];
        memcpy(row, s->p[c], sizeof row);
        for (j = 0; j < N; j++)
            gain[j] = s->p[j][c] / spread;
        for (j = 0; j < N && seen[i]; j++) {
            double left;
            for (k = 0; k < N; k++)
                s->p[j][k] -= gain[j] * row[k];
            left = s->p[j][c];
            for (k = 0; k < N; k++)
                s->p[j][k] += gain[k] * (gain[j] * variance[i] - left);
            s->x[j] += gain[j] * off;
        }
    }
    for (i = 0; i < M; i++)
        if (!seen[i] && isfinite(y[sensed[i]]))
            s->p[sensed[i]][sensed[i]] += unknown[sensed[i]];
    for (i = 0; i < N; i++) {
        sound = sound && isfinite(s->x[i]) && (confirmed[i] || fabs(s->x[i]) <= farthest[i]);
        for (j = 0; j < N; j++)
            sound = sound && isfinite(s->p[i][j]);
    }
    if (!sound)
        begin(s, y);
}

/* Predict the state at the time at which the next input arrives at the plant. */
static void ahead({{ name }}_state *s, double x[N])
{
    int i;
    memcpy(x, s->x, sizeof s->x);
@ for age, seconds, steps in observer.passages()[1]
    flow(x, s->inputs[MEMORY - {{ age }}], {{ (seconds / steps) | number }}, {{ steps }});
@ endfor
    for (i = 0; i < N; i++)
        if (!isfinite(x[i]))
            x[i] = s->x[i];
}

@ if pushed
/* Offset-free control: find dx and du with f(x - dx, u - du) = f(x, u) + push and C dx = 0, by two damped Gauss-Newton
 * steps. */
static void counteract({{ name }}_state *s, const double x[N])
{
    enum { NZ = NX + NU };
    static const double range[NZ] = { {{- range | numbers -}} }; /* of states and inputs */
    double slopes[NX][NZ], normal[NZ][NZ + 1], z[N + NU], wanted[N], forth[N], back[N];
    const double *u = s->inputs[MEMORY - 1];
    int i, j, k, turn, outside = 1;
    memset(z, 0, sizeof z); /* states, pushes, which are none, and inputs */
    rates(x, u, wanted);
    for (turn = 0; turn < {{ turns[1] }} && (turn < {{ turns[0] }} || outside); turn++) {
        for (j = 0; j < NZ; j++)
            z[j < NX ? j : j + N - NX] = (j < NX ? x[j] : u[j - NX]) - s->shift[j];
        for (j = 0; j < NZ; j++) {
            double *point = &z[j < NX ? j : j + N - NX];
            const double kept = *point, nudge = 1e-4 * range[j];
            *point = kept + nudge;
            rates(z, z + N, forth);
            *point = kept - nudge;
            rates(z, z + N, back);
            *point = kept;
            for (i = 0; i < NX; i++)
                slopes[i][j] = (forth[i] - back[i]) / (2e-4 * range[i]);
        }
        rates(z, z + N, forth);
        for (j = 0; j < NZ; j++)
            for (k = 0; k <= NZ; k++) { /* the right side behind the matrix */
                normal[j][k] = j == k ? 1e-4 : 0.0;
                for (i = 0; i < NX; i++)
                    normal[j][k] += slopes[i][j] * (k < NZ ? slopes[i][k] : (forth[i] - wanted[i]) / range[i]);
            }
        for (i = 0; i < NR; i++) {
            normal[output[i]][output[i]] += 1.0;
            normal[output[i]][NZ] -= s->shift[output[i]] / range[output[i]];
        }
        for (i = 0; i < NZ; i++) /* elimination by Gauss and Jordan; the matrix is positive definite */
            for (j = 0; j < NZ; j++) {
                const double factor = i == j ? 0.0 : normal[j][i] / normal[i][i];
                for (k = i; k <= NZ; k++)
                    normal[j][k] -= factor * normal[i][k];
            }
        outside = 0;
        for (j = 0; j < NZ; j++) {
            const double found = s->shift[j] + normal[j][NZ] / normal[j][j] * range[j];
            const double most = {{ most | number }} * range[j]; /* beyond it is another branch of the model */
            outside = outside || !(fabs(found) < most);
            s->shift[j] = isfinite(found) ? fmax(-most, fmin(found, most)) : found;
        }
    }
    if (outside)
        memset(s->shift, 0, sizeof s->shift);
}
@ endif
