/* Trajectories of a vector field whose formulas are a list of instructions: nothing is compiled for each field.
   Each value is an array of W rows, so that an instruction is read once for all of them. */
#include <math.h>
#include <string.h>

enum { W = @width@ };
enum { ADD, SUB, MUL, DIV, NEGATIVE, SIN, COS, EXP, TANH, SQRT, FABS, SIGN, SQUARE, LARGER };

#define EACH(value) for (int r = 0; r < W; r++) { double p = a[r], q = b[r]; (void)p; (void)q; c[r] = (value); } break

static void rates(long n, const int *restrict code, double (*v)[W])
{
    for (long k = 0; k < n; k++, code += 4) {
        const double *a = v[code[1]], *b = v[code[2]];
        double *restrict c = v[code[3]];
        switch (code[0]) {
        case ADD: EACH(p + q);
        case SUB: EACH(p - q);
        case MUL: EACH(p * q);
        case DIV: EACH(p / q);
        case NEGATIVE: EACH(-p);
        case SIN: EACH(sin(p));
        case COS: EACH(cos(p));
        case EXP: EACH(exp(p));
        case TANH: EACH(tanh(p));
        case SQRT: EACH(sqrt(p));
        case FABS: EACH(fabs(p));
        case SIGN: EACH((double)((p > 0) - (p < 0)));
        case SQUARE: EACH(p * p);
        case LARGER: EACH(p < q ? q : p); /* p, if that is no number */
        }
    }
}

/* x: (rows, n_x) and u: (rows, periods, n_u) give ends: (rows, periods, n_x). The first values of `room` are states and
   inputs, then come `n_k` constants; behind all `n_v` values are 4 n_x arrays of the steps. Of a difference equation a
   step has one stage. */
void simulate(long rows, long periods, int n_x, int n_u, int n_k, int n_v, long n, const int *code, const int *results,
              const double *constants, double h, int steps, int difference, const double *x, const double *u,
              double *ends, double *room)
{
    double (*v)[W] = (double (*)[W])room, (*at)[W] = v + n_v, (*sum)[W] = at + n_x, (*once)[W] = sum + n_x;
    static const double ahead[4] = {0, 0.5, 0.5, 1};
    for (int k = 0; k < n_k; k++)
        for (int r = 0; r < W; r++) v[n_x + n_u + k][r] = constants[k];
    for (long first = 0; first < rows; first += W) {
        int width = rows - first < W ? (int)(rows - first) : W;
        for (int i = 0; i < n_x; i++)
            for (int r = 0; r < W; r++) at[i][r] = x[(first + (r < width ? r : 0)) * n_x + i];
        for (long t = 0; t < periods; t++) {
            for (int j = 0; j < n_u; j++)
                for (int r = 0; r < W; r++) v[n_x + j][r] = u[((first + (r < width ? r : 0)) * periods + t) * n_u + j];
            for (int s = 0; s < steps; s++) {
                for (int stage = 0; stage < (difference ? 1 : 4); stage++) {
                    for (int i = 0; i < n_x; i++) {
                        if (stage == 0) { memcpy(v[i], at[i], sizeof *v); continue; }
                        const double *k = v[results[i]], size = h * ahead[stage];
                        double *restrict outer = sum[i], *restrict inner = once[i];
                        for (int r = 0; r < W; r++) {
                            if (stage == 1) outer[r] = k[r];
                            else inner[r] = stage == 2 ? k[r] : inner[r] + k[r];
                        }
                        for (int r = 0; r < W; r++) v[n_v - n_x + i][r] = at[i][r] + size * k[r];
                    }
                    if (stage) memcpy(v, v + n_v - n_x, n_x * sizeof *v); /* all at once: a rate may be another state */
                    rates(n, code, v);
                }
                for (int i = 0; i < n_x; i++) {
                    const double *k = v[results[i]];
                    for (int r = 0; r < W; r++)
                        once[i][r] = difference ? at[i][r] + h * k[r]
                                                : at[i][r] + h / 6 * ((sum[i][r] + k[r]) + 2 * once[i][r]);
                }
                memcpy(at, once, n_x * sizeof *at);
            }
            for (int r = 0; r < width; r++)
                for (int i = 0; i < n_x; i++) ends[((first + r) * periods + t) * n_x + i] = at[i][r];
        }
    }
}
