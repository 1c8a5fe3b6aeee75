
/* ---- Offset-free control: the estimated push is counteracted ---- */

static const double whole_scale[NX + NU] = {@whole_scale@}; /* ranges of states and inputs */

/* Find dx and du with f(x - dx, u - du) = f(x, u) + push and C dx = 0, by two damped Gauss-Newton steps. */
static void counteract(@name@_state *s, const double x[N])
{
    double slopes[NX][NX + NU], normal[NX + NU][NX + NU], missing[NX + NU], z[NX + NU];
    double wanted[NX], forth[NX], back[NX];
    const double *u = s->inputs[MEMORY - 1];
    int i, j, k, turn, sound = 1;
    field(x, u, wanted);
    for (i = 0; i < N - NX; i++)
        wanted[pushed[i]] += x[NX + i];
    for (turn = 0; turn < 2; turn++) {
        for (i = 0; i < NX + NU; i++)
            z[i] = (i < NX ? x[i] : u[i - NX]) - s->shift[i];
        for (j = 0; j < NX + NU; j++) {
            const double point = z[j], nudge = 1e-4 * whole_scale[j];
            z[j] = point + nudge;
            field(z, z + NX, forth);
            z[j] = point - nudge;
            field(z, z + NX, back);
            z[j] = point;
            for (i = 0; i < NX; i++)
                slopes[i][j] = (forth[i] - back[i]) / (2e-4 * whole_scale[i]);
        }
        field(z, z + NX, forth);
        for (i = 0; i < NX; i++)
            forth[i] = (forth[i] - wanted[i]) / whole_scale[i];
        for (j = 0; j < NX + NU; j++) {
            missing[j] = 0.0;
            for (i = 0; i < NX; i++)
                missing[j] += slopes[i][j] * forth[i];
            for (k = 0; k < NX + NU; k++) {
                normal[j][k] = j == k ? 1e-4 : 0.0;
                for (i = 0; i < NX; i++)
                    normal[j][k] += slopes[i][j] * slopes[i][k];
            }
        }
        for (i = 0; i < NR; i++) {
            normal[output[i]][output[i]] += 1.0;
            missing[output[i]] -= s->shift[output[i]] / whole_scale[output[i]];
        }
        sound = sound && solve(&normal[0][0], missing, NX + NU, 1);
        for (j = 0; j < NX + NU; j++)
            s->shift[j] += missing[j] * whole_scale[j];
    }
    for (j = 0; j < NX + NU; j++)
        sound = sound && isfinite(s->shift[j]);
    for (j = 0; j < NX + NU && !sound; j++)
        s->shift[j] = 0.0;
}
