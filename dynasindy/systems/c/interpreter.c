/* Trajectories of a vector field whose formulas are a list of instructions, and their derivatives: nothing is compiled
   for each field. Each value is an array of W rows, so that an instruction is read once for all of them. */
#include <math.h>
#include <string.h>

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#if __GLIBC_PREREQ(2, 35) /* its functions are there for several numbers at once, to four units in the last place */
#define SEVERAL __attribute__((__simd__("notinbranch"))) double
SEVERAL sin(double);
SEVERAL cos(double);
SEVERAL exp(double);
SEVERAL tanh(double);
#endif
#endif

enum { W = @width@, TILE = 8 }; /* rows that are computed at once, and columns that stay in fast memory */
enum { ADD, SUB, MUL, DIV, NEGATIVE, SIN, COS, EXP, TANH, SQRT, FABS, SIGN, SQUARE, LARGER, EXCEEDS };

#define EACH(value) for (int r = 0; r < W; r++) { double p = a[r], q = b[r]; (void)p; (void)q; c[r] = (value); } break

static void evaluate(long n, const int *restrict code, double (*v)[W])
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
        case EXCEEDS: EACH((double)(p > q));
        }
    }
}

static const double ahead[4] = {0, 0.5, 0.5, 1};

/* Inputs of W rows a share of their interval after its begin: u, or between u and u_end where there is one. `every`
   intervals of a row follow each other. */
static void put_inputs(double (*v)[W], long first, int width, int n_u, long every, const double *u, const double *u_end,
                       double share)
{
    for (int j = 0; j < n_u; j++)
        for (int r = 0; r < W; r++) {
            long at = (first + (r < width ? r : 0)) * every * n_u + j;
            v[j][r] = u_end ? u[at] + share * (u_end[at] - u[at]) : u[at];
        }
}

/* The observer of W rows: states after a period are corrected by `gain`: (n_x, n_x) times what their ends miss of what
   was measured, which is NaN where nothing was, and their derivatives alike. `n_g` of the columns are those by elements
   of the gain, whose rows and columns are `places`. */
static void correct(const double *gain, int n_x, int width, long every, const double *measured, const double *ends,
                    double (*at)[W], double (*s)[W], long columns, int n_g, const int *places)
{
    double error[n_x][W], part[W];
    for (int j = 0; j < n_x; j++) {
        for (int r = 0; r < W; r++) {
            long place = (r < width ? r : 0) * every + j;
            double missed = measured[place] - ends[place];
            error[j][r] = missed == missed ? missed : 0;
        }
        for (int i = 0; i < n_x; i++)
            for (int r = 0; r < W; r++) at[i][r] += gain[i * n_x + j] * error[j][r];
    }
    for (long k = 0; k < columns; k++) {
        double sum[n_x][W];
        memset(sum, 0, sizeof sum);
        for (int j = 0; j < n_x; j++) {
            for (int r = 0; r < W; r++) {
                double y = measured[(r < width ? r : 0) * every + j];
                part[r] = y == y ? s[j * columns + k][r] : 0;
            }
            for (int i = 0; i < n_x; i++)
                for (int r = 0; r < W; r++) sum[i][r] += gain[i * n_x + j] * part[r];
        }
        for (int i = 0; i < n_x; i++)
            for (int r = 0; r < W; r++) s[i * columns + k][r] -= sum[i][r];
    }
    for (int k = 0; k < n_g; k++)
        for (int r = 0; r < W; r++) s[places[k] * columns + n_x + k][r] += error[places[n_g + k]][r];
}

/* Sums: `to[k]` of what is computed grows by `by[k]` times `from[k]` of the values. */
struct sums { int n; const int *to, *from; const double *by; };
/* A matrix that is mostly zero: row and column of each element that is not. */
struct places { int n; const int *row, *column; };
/* What the steps of W rows read and write: states at the begin of each, rates, and, of the stages of a step, functions,
   slopes of the rates by states and by numbers inside functions, and weights of the rates in an end. */
struct flow {
    int n_x, n_f, stages, steps;
    double h;
    const int *code, *features;
    struct sums rates, by_state, by_shape;
    struct places state_places, shape_places;
    double (*v)[W], (*at)[W], (*rate)[W], (*theta)[W], (*of_state)[W], (*of_shape)[W], (*weight)[W], (*moved)[W];
};

static void add_up(struct sums sums, int n, double (*v)[W], double (*result)[W])
{
    memset(result, 0, n * sizeof *result);
    for (int k = 0; k < sums.n; k++) {
        const double *p = v[sums.from[k]], by = sums.by[k];
        double *restrict c = result[sums.to[k]];
        for (int r = 0; r < W; r++) c[r] += by * p[r];
    }
}

/* One stage of step s, by the first `n` instructions; of all of them there are slopes, too. */
static void pass_stage(const struct flow *f, int s, int stage, long n, int slopes)
{
    double (*at)[W] = f->at + s * f->n_x, (*rate)[W] = f->rate + stage * f->n_x, size = f->h * ahead[stage];
    for (int i = 0; i < f->n_x; i++)
        for (int r = 0; r < W; r++) f->v[i][r] = stage ? at[i][r] + size * rate[i - f->n_x][r] : at[i][r];
    evaluate(n, f->code, f->v);
    add_up(f->rates, f->n_x, f->v, rate);
    if (!slopes) return;
    for (int k = 0; k < f->n_f; k++) memcpy(f->theta + stage * f->n_f + k, f->v + f->features[k], sizeof *f->v);
    add_up(f->by_state, f->state_places.n, f->v, f->of_state + stage * f->state_places.n);
    add_up(f->by_shape, f->shape_places.n, f->v, f->of_shape + stage * f->shape_places.n);
}

/* The states after step s, by the rates of its stages. */
static void end_step(const struct flow *f, int s)
{
    double (*at)[W] = f->at + s * f->n_x, (*next)[W] = at + f->n_x, (*k)[W] = f->rate;
    int n = f->n_x;
    for (int i = 0; i < n; i++, k++)
        for (int r = 0; r < W; r++)
            next[i][r] = f->stages == 1 ? at[i][r] + f->h * k[0][r]
                                        : at[i][r] + f->h / 6 * ((k[0][r] + k[3 * n][r]) + 2 * (k[n][r] + k[2 * n][r]));
}

/* A row times a matrix that is mostly zero, `elements`, is added to another row. */
static void multiply(struct places places, double (*row)[W], double (*elements)[W], double (*result)[W])
{
    for (int k = 0; k < places.n; k++) {
        const double *p = row[places.row[k]], *q = elements[k];
        double *restrict c = result[places.column[k]];
        for (int r = 0; r < W; r++) c[r] += p[r] * q[r];
    }
}

/* Weights of the rates of a stage times their slopes by the states. */
static void move_weights(const struct flow *f, int stage)
{
    double (*moved)[W] = f->moved + stage * f->n_x, (*slopes)[W] = f->of_state + stage * f->state_places.n;
    memset(moved, 0, f->n_x * sizeof *moved);
    multiply(f->state_places, f->weight + stage * f->n_x, slopes, moved);
}

/* From the weights of the states after a step to those of its rates, and of the states before. */
static void weigh_stages(const struct flow *f, double (*after)[W])
{
    long n = (long)f->n_x * W;
    double *end = *after, *a = *f->weight, *p = *f->moved, h = f->h;
    if (f->stages == 1) {
        for (long k = 0; k < n; k++) a[k] = h * end[k];
        move_weights(f, 0);
        for (long k = 0; k < n; k++) end[k] += p[k];
        return;
    }
    for (long k = 0; k < n; k++) a[3 * n + k] = h / 6 * end[k];
    for (int stage = 3; stage > 0; stage--) {
        double own = stage == 1 ? 1 : 2, size = h * ahead[stage];
        move_weights(f, stage);
        for (long k = 0; k < n; k++) a[(stage - 1) * n + k] = own * a[3 * n + k] + size * p[stage * n + k];
    }
    move_weights(f, 0);
    for (long k = 0; k < n; k++) end[k] += (p[k] + p[n + k]) + (p[2 * n + k] + p[3 * n + k]);
}

/* What the rates of all stages add to the derivatives of a state after the interval, by their weights in it. */
static void add_own(const struct flow *f, int n_p, const int *feature, const int *state, double (*own)[W])
{
    int n_x = f->n_x, n_f = f->n_f;
    for (int k = 0; k < n_p; k++) {
        const double *p = f->weight[state[k]], *q = f->theta[feature[k]];
        double *restrict c = own[k];
        for (int r = 0; r < W; r++)
            c[r] += (p[r] * q[r] + p[n_x * W + r] * q[n_f * W + r]) +
                    (p[2 * n_x * W + r] * q[2 * n_f * W + r] + p[3 * n_x * W + r] * q[3 * n_f * W + r]);
    }
}

/* From the derivatives of an interval's end by its begin to those by the begin of the first interval. */
static void chain(int n_x, long columns, double (*own)[W], double (*before)[W], double (*s)[W])
{
    for (long first = 0; first < columns; first += TILE) {
        long last = first + TILE < columns ? first + TILE : columns;
        for (int i = 0; i < n_x; i++) {
            for (long k = first; k < last; k++) {
                if (k < n_x) memset(s[i * columns + k], 0, sizeof *s);
                else memcpy(s[i * columns + k], own[i * columns + k], sizeof *s);
            }
            for (int j = 0; j < n_x; j++)
                for (long k = first; k < last; k++) {
                    const double *p = own[i * columns + j], *q = before[j * columns + k];
                    double *restrict c = s[i * columns + k];
                    for (int r = 0; r < W; r++) c[r] += p[r] * q[r];
                }
        }
    }
}

/* x: (rows, n_x), u and u_end, which may be none: (rows, periods, n_u) give ends: (rows, periods, n_x), and their
   derivatives by the states x, elements of the gain, the numbers inside functions and the coefficients, slopes:
   (rows, periods, n_x, n_x + n_g + n_s + n_p), unless there is no room for these. With a gain states are corrected by
   what was measured: (rows, periods, n_x), before the next period. Of a difference equation a step has one stage. The
   first values of `room` are states and inputs, then come `n_k` constants and what is computed. The first `n_values` instructions compute functions, the others their
   slopes. A step k1 .. k4 of h moves an error of its end by a4 = h/6, a3 = h/3 + h a4 J4, a2 = h/3 + h/2 a3 J3 and
   a1 = h/6 + h/2 a2 J2 times the errors of its four rates, where J are the slopes of the rates by the states: so each
   function is weighed once. */
void simulate(long rows, long periods, int n_x, int n_u, int n_k, int n_v, int n_f, int n_s, int n_p, long n_values,
              long n, const int *code, const int *features, int n_rates, const int *rates, const double *rates_by,
              int n_states, const int *states, const double *states_by, int n_shapes, const int *shapes,
              const double *shapes_by, int n_state_places, const int *state_places, int n_shape_places,
              const int *shape_places, const int *parameters, const double *constants, double h, int steps,
              int difference, const double *x, const double *u, const double *u_end, double *ends, double *slopes,
              double *room, const double *measured, const double *gain, int n_g, const int *places)
{
    struct flow f = {n_x, n_f, difference ? 1 : 4, steps, h, code, features,
                     {n_rates, rates, rates + n_rates, rates_by}, {n_states, states, states + n_states, states_by},
                     {n_shapes, shapes, shapes + n_shapes, shapes_by},
                     {n_state_places, state_places, state_places + n_state_places},
                     {n_shape_places, shape_places, shape_places + n_shape_places},
                     NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL};
    long columns = slopes ? n_x + n_g + n_s + n_p : 0, size = n_x * columns;
    f.v = (double (*)[W])room;
    f.at = f.v + n_v;
    f.rate = f.at + (steps + 1) * n_x;
    f.theta = f.rate + 4 * n_x;
    f.of_state = f.theta + 4 * n_f;
    f.of_shape = f.of_state + 4 * n_state_places;
    f.weight = f.of_shape + 4 * n_shape_places;
    f.moved = f.weight + 4 * n_x;
    double (*own)[W] = f.moved + 4 * n_x, (*s)[W] = own + size, (*spare)[W] = s + size;
    if (difference) memset(f.theta, 0, (own - f.theta) * sizeof *own); /* of stages that it has not */
    for (int k = 0; k < n_k; k++)
        for (int r = 0; r < W; r++) f.v[n_x + n_u + k][r] = constants[k];
    for (long first = 0; first < rows; first += W) {
        int width = rows - first < W ? (int)(rows - first) : W;
        for (int i = 0; i < n_x; i++)
            for (int r = 0; r < W; r++) f.at[i][r] = x[(first + (r < width ? r : 0)) * n_x + i];
        for (long t = 0; t < periods; t++) {
            const double *begin = u + t * n_u, *end = u_end ? u_end + t * n_u : NULL;
            if (t) memcpy(f.at, f.at + steps * n_x, n_x * sizeof *f.at);
            put_inputs(f.v + n_x, first, width, n_u, periods, begin, end, 0);
            memset(own, 0, size * sizeof *own);
            for (int i = 0; i < n_x && slopes; i++)
                for (int r = 0; r < W; r++) own[i * columns + i][r] = 1;
            /* Backwards: all steps but the last are passed once without slopes, and once with them. */
            for (int pass = 0; pass < (slopes ? 2 * steps - 1 : steps); pass++) {
                int at = pass < steps ? pass : 2 * steps - 2 - pass, with = slopes && pass >= steps - 1;
                for (int stage = 0; stage < f.stages; stage++) {
                    double share = (at + ahead[stage]) / steps;
                    if (end) put_inputs(f.v + n_x, first, width, n_u, periods, begin, end, share);
                    pass_stage(&f, at, stage, with ? n : n_values, with);
                }
                if (pass < steps) end_step(&f, at);
                for (int i = 0; with && i < n_x; i++) {
                    weigh_stages(&f, own + i * columns);
                    for (int stage = 0; stage < f.stages; stage++)
                        multiply(f.shape_places, f.weight + stage * n_x, f.of_shape + stage * f.shape_places.n,
                                 own + i * columns + n_x + n_g);
                    add_own(&f, n_p, parameters, parameters + n_p, own + i * columns + n_x + n_g + n_s);
                }
            }
            if (t && slopes) {
                double (*before)[W] = s;
                chain(n_x, columns, own, before, spare);
                s = spare;
                spare = before;
            }
            else memcpy(s, own, size * sizeof *s);
            for (int r = 0; r < width; r++)
                for (int i = 0; i < n_x; i++) ends[((first + r) * periods + t) * n_x + i] = f.at[steps * n_x + i][r];
            for (long some = 0; some < size; some += TILE)
                for (int r = 0; r < width; r++) {
                    double *to = slopes + ((first + r) * periods + t) * size;
                    for (long k = some; k < size && k < some + TILE; k++) to[k] = s[k][r];
                }
            long row = (first * periods + t) * n_x;
            double (*last)[W] = f.at + steps * n_x;
            if (gain)
                correct(gain, n_x, width, periods * n_x, measured + row, ends + row, last, s, columns, slopes ? n_g : 0,
                        places);
        }
    }
}
