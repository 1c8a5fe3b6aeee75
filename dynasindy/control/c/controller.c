/* Written from a controller, not by hand. In each period, in this order:
 *
 *   advance, correct   the observer predicts to the time of the measurement, and takes it in
 *   ahead              it predicts to the time at which the next input arrives at the plant
 *   counteract         what the estimated push would do is taken out of the state, and added to the input
 *   layer              u = tanh(W LeakyReLU(...) + b) of the scaled state and error, shifted by the integral
 *   last               the integral takes in the error
 *
 * as far as the controller has them. */
#include "{{ name }}.h"

#include <math.h>
#include <string.h>

enum {
    NX = {{ name }}_NX,
    NU = {{ name }}_NU,
    NR = {{ name }}_NR,
@ if observer
    N = {{ name }}_N,
    M = {{ sensed | length }},
    MEMORY = {{ name }}_MEMORY,
@ else
    N = NX,
@ endif
};

/* Ranges of the states. */
static const double scale[NX] = { {{- signature.x_scale | numbers -}} };
/* Places of the tracked states. */
static const int output[NR] = { {{- task.outputs | join(", ") -}} };
/* Extents of their targets. */
static const double box[NR] = { {{- task.boxes() | numbers -}} };
@ if integral
/* Places of their rates, -1 where there is none. */
static const int moves[NR] = { {{- moves | join(", ") -}} };
@ endif
/* Of the inputs. */
static const double least[NU] = { {{- task.input_limits[0] | numbers -}} };
static const double most[NU] = { {{- task.input_limits[1] | numbers -}} };

@ if observer
/* ---- The model{{ ", and constant pushes behind its states" if pushed else "" }} ---- */

{% include "flow.c" %}
{% include "observer.c" %}
@ endif
/* ---- The policy: LeakyReLU layers, and tanh at the end ---- */

@ for w, b in weights
static const float w{{ loop.index0 }}[{{ w.numel() }}] = {
{{ w.flatten() | floats }}
};
static const float b{{ loop.index0 }}[{{ b.numel() }}] = {
{{ b | floats }}
};

@ endfor
/* y = W x + b; where it is negative it is made a hundredth unless it is the last layer. Four sums go side by side, as a
 * processor starts an addition before the one before is done. */
static void layer(const float *w, const float *b, const float *x, float *y, int n_in, int n_out, int last)
{
    int i, j;
    for (i = 0; i < n_out; i++, w += n_in) {
        double sum = b[i], second = 0.0, third = 0.0, fourth = 0.0;
        for (j = 0; j + 3 < n_in; j += 4) {
            sum += (double)w[j] * (double)x[j];
            second += (double)w[j + 1] * (double)x[j + 1];
            third += (double)w[j + 2] * (double)x[j + 2];
            fourth += (double)w[j + 3] * (double)x[j + 3];
        }
        for (; j < n_in; j++)
            sum += (double)w[j] * (double)x[j];
        sum += second + third + fourth;
        y[i] = (float)(sum < 0.0 && !last ? 0.01 * sum : sum);
    }
}

/* ---- The controller ---- */

void {{ name }}_reset({{ name }}_state *s)
{
    memset(s, 0, sizeof *s);
}

int {{ name }}_act({{ name }}_state *s, const double y[NX], const double r[NR], const double rate[NR], double u[NU])
{
    const {{ name }}_state before = *s;
    const double *kept = (const double *)s; /* all of it is of this type */
    double x[N], slope[NR], found[NU];
    float a[{{ widest }}], b[{{ widest }}];
    int i, fine = 1;
    memcpy(u, s->u, sizeof s->u);
    for (i = 0; i < NR; i++) {
        slope[i] = rate ? rate[i] : 0.0;
        fine = fine && isfinite(r[i]) && isfinite(slope[i]);
    }
@ if observer
    for (i = 0; i < M; i++)
        fine = fine && !isinf(y[sensed[i]]);
@ else
    for (i = 0; i < NX; i++) {
        x[i] = y[i];
        fine = fine && isfinite(x[i]);
    }
@ endif
    if (!fine)
        return {{ name }}_REFUSED;
@ if observer
    if (s->begun > 0.0) {
        advance(s);
        correct(s, y);
    } else
        begin(s, y);
    s->begun = 1.0;
    ahead(s, x);
@ endif
@ if pushed
    counteract(s, x);
    for (i = 0; i < NX; i++)
        x[i] -= s->shift[i];
@ endif
    /* The observation: states by their ranges, errors by their scale{{ ", rates of the reference" if task.observe_rate else "" }}. */
    for (i = 0; i < NX; i++)
        a[i] = (float)(x[i] / scale[i]);
    for (i = 0; i < NR; i++) {
        a[NX + i] = (float)((r[i] - x[output[i]]) / ({{ task.error_scale | number }} * box[i]));
@ if integral
        a[NX + i] += (float)(s->integral[i] / {{ task.error_scale | number }});
@ endif
@ if task.observe_rate
        a[NX + NR + i] = (float)(slope[i] / box[i]);
@ endif
    }
@ for w, _ in weights
    layer(w{{ loop.index0 }}, b{{ loop.index0 }}, {{ loop.cycle("a, b", "b, a") }}, {{ w.shape[1] }}, {{ w.shape[0] }}, {{ loop.last | int }});
@ endfor
@ if integral
    for (i = 0; i < NR; i++) { /* I += gain dt e of a steady error: none beyond the band, and of one that moves less */
        const double error = (r[i] - x[output[i]]) / box[i];
        const double moving = moves[i] < 0 ? 0.0 : (slope[i] - x[moves[i]]) / box[i] / {{ integral.rate | number }};
        if (fabs(error) < {{ integral.band | number }})
            s->integral[i] += {{ integral.gain | number }} * {{ dt }} * error / (1.0 + moving * moving);
        s->integral[i] = fmax(-{{ integral.limit | number }}, fmin(s->integral[i], {{ integral.limit | number }}));
    }
@ endif
    for (i = 0; i < NU; i++) {
        found[i] = tanh((double){{ "b" if weights | length is odd else "a" }}[i]);
@ if pushed
        found[i] += s->shift[NX + i];
@ endif
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
        return {{ name }}_REFUSED;
    }
    memcpy(u, found, sizeof found);
    memcpy(s->u, found, sizeof found);
@ if observer
    memmove(s->inputs[0], s->inputs[1], (MEMORY - 1) * sizeof s->inputs[0]);
    memcpy(s->inputs[MEMORY - 1], found, sizeof found);
@ endif
    return {{ name }}_OK;
}
