@ set head, result = "static void rates(const double *x, const double *u, double *dx)", "dx"
{% include "field.c" %}
@ if stops
/* A position at the end of its travel stays there, and a rate that leads further is zero. */
static void stop(double *position, double *rate, double low, double high)
{
    const int below = *position <= low, above = *position >= high;
    if (below)
        *position = low;
    else if (above)
        *position = high;
    if ((below && *rate < 0.0) || (above && *rate > 0.0))
        *rate = 0.0;
}

@ endif
@ set kind = "the classical Runge-Kutta method of fourth order" if model.step is none else "the difference equation x + h f(x, u)"
/* Move states on under held inputs, by steps of {{ kind }}. */
static void flow(double x[N], const double u[NU], double h, int steps)
{
    const double reach[4] = {0.5, 0.5, 1.0, 0.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    double k[N], sum[N], z[N];
    int i, s, stage;
    for (s = 0; s < steps; s++) {
        for (i = 0; i < N; i++) {
            sum[i] = 0.0;
            z[i] = x[i];
        }
        for (stage = 0; stage < {{ 4 if model.step is none else 1 }}; stage++) {
            rates(z, u, k);
            for (i = 0; i < N; i++) {
                sum[i] += weight[stage] * k[i];
                z[i] = x[i] + reach[stage] * h * k[i];
            }
        }
        for (i = 0; i < N; i++)
            x[i] += h / {{ "6.0" if model.step is none else "1.0" }} * sum[i];
@ for position, rate, low, high in stops
        stop(&x[{{ position }}], &x[{{ rate }}], {{ low | bound }}, {{ high | bound }});
@ endfor
    }
}
