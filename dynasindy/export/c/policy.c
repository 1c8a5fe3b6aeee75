
/* ---- The policy: LeakyReLU layers, and tanh at the end ---- */

@weights@

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

/* The observation: states by their ranges, errors by their scale@rates_word@. */
static void policy(@of_state@const double x[NX], const double r[NR], @of_rate@double u[NU])
{
    float a[@widest@], b[@widest@];
    int i;
    for (i = 0; i < NX; i++)
        a[i] = (float)(x[i] / scale[i]);
    for (i = 0; i < NR; i++) {
        a[NX + i] = (float)((r[i] - x[output[i]]) / (@error_scale@ * box[i]));
@if integral
        a[NX + i] += (float)(s->integral[i] / @error_scale@);
@end
@if observe_rate
        a[NX + NR + i] = (float)(rate[i] / box[i]);
@end
    }
@layers@
    for (i = 0; i < NU; i++)
        u[i] = tanh((double)@last@[i]);
}
