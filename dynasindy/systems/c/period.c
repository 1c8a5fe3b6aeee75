/* Control periods of a vector field, and the derivatives of one, for many rows at once. Generated code fills the gaps.
   A step has four stages, those of Runge and Kutta, or the one of a difference equation. */
#include <math.h>

typedef @real@ real;
enum { N = @n_x@, M = @n_u@, C = N + M, P = @n_slopes@, W = @width@, STAGES = @stages@,
       AFFINE = @affine@ }; /* W rows at once stay in the first cache */

static inline real square(real v) { return v * v; }
static inline real larger(real a, real b) { return a < b ? b : a; } /* a, if that is no number */
static inline real exceeds(real a, real b) { return a > b ? 1 : 0; }
static inline real sign(real v) { return (real)((v > 0) - (v < 0)); }
static inline real magnitude(real v) { return v < 0 ? -v : v; }

/* An array of n numbers, in the caller's `room`: of many states they are more than a stack has. */
#define ARRAY(name, n) real *restrict name = room; room += (n)

#if @single@
static inline int is_odd(real whole) { return whole != 2 * rintf((real)0.5 * whole); } /* without an int, which may overflow */

/* The functions of <math.h>, but such that a compiler can compute them for several rows by one instruction. */
static inline real odd(real far) /* sin r within a quarter turn: Abramowitz and Stegun, 4.3.97 */
{
    real r = far < (real)-1.6 ? (real)-1.6 : far > (real)1.6 ? (real)1.6 : far; /* no more, if turns cannot be told */
    real s = r * r;
    real p = (real)2.7526e-6 + s * (real)-2.39e-8;
    p = (real)8.3333315e-3 + s * ((real)-1.984090e-4 + s * p);
    return r + r * s * ((real)-1.666666664e-1 + s * p);
}
static inline real sine(real v)
{
    real turns = rintf(v * (real)0.31830988618379067);
    real r = ((v - turns * (real)3.140625) - turns * (real)9.67502593994140625e-4) - turns * (real)1.509957990978376e-7;
    real p = odd(r);
    return is_odd(turns) ? -p : p;
}
static inline real cosine(real v)
{
    real turns = rintf(v * (real)0.31830988618379067 - (real)0.5) + (real)0.5;
    real r = ((v - turns * (real)3.140625) - turns * (real)9.67502593994140625e-4) - turns * (real)1.509957990978376e-7;
    real p = odd(r);
    return is_odd(turns - (real)0.5) ? p : -p;
}
static inline real power_of_e(real v)
{
    union { unsigned i; real r; } two;
    real bounded = v < -87 ? -87 : v > 89 ? 89 : v; /* beyond 88.4 it is infinite */
    real whole = rintf(bounded * (real)1.4426950408889634);
    real r = (bounded - whole * (real)0.693359375) + whole * (real)2.12194440e-4;
    real p = (real)1.9875691500e-4;
    p = p * r + (real)1.3981999507e-3;
    p = p * r + (real)8.3334519073e-3;
    p = p * r + (real)4.1665795894e-2;
    p = p * r + (real)1.6666665459e-1;
    p = p * r + (real)5.0000001201e-1;
    two.i = (unsigned)((int)(whole == whole ? whole : 0) + 127) << 23;
    return (p * r * r + r + 1) * two.r;
}
static inline real hyperbolic_tangent(real v)
{
    real bounded = v < -9 ? -9 : v > 9 ? 9 : v;
    real e = power_of_e(2 * bounded);
    real small = bounded * (1 - square(bounded) / 3);
    return magnitude(bounded) < (real)0.01 ? small : (e - 1) / (e + 1);
}
#endif

/* dx/dt of W rows, `x` and `f` by state. */
static void rates(const real *restrict x, const real *restrict u, const real *restrict k, real *restrict f)
{
    for (int r = 0; r < W; r++) {
@rates@
    }
}

static void gather(const real *from, long rows, long first, int n, real *to)
{
    for (int r = 0; r < W; r++) {
        long row = first + r < rows ? first + r : rows - 1;
        for (int i = 0; i < n; i++)
            to[i * W + r] = from[row * n + i];
    }
}

/* The states after each of `steps` steps of h [s] of each of `periods`, under inputs of their own, and whether a stop
   was touched; inputs and results are by period, then by row. At a stop a position is held and its outward rate is
   zero. */
void advance(long periods, long rows, const real *x0, const real *u0, const real *k, real h, int steps, int n_stops,
             const int *position, const int *rate, const real *low, const real *high, real *out, unsigned char *touched,
             real *room)
{
    int at[W];
    ARRAY(x, N * W); ARRAY(u, M * W); ARRAY(y, N * W);
    ARRAY(a, N * W); ARRAY(b, N * W); ARRAY(c, N * W); ARRAY(d, N * W);
    for (long first = 0; first < rows; first += W) {
        for (long period = 0; period < periods; period++) {
            const long before = period * rows;
            if (period == 0)
                gather(x0, rows, first, N, x);
            gather(u0 + before * M, rows, first, M, u);
            for (int r = 0; r < W; r++)
                at[r] = 0;
            for (int step = 0; step < steps; step++) {
                rates(x, u, k, a);
                if (STAGES == 1) {
                    for (int i = 0; i < N * W; i++) x[i] += h * a[i];
                } else {
                    for (int i = 0; i < N * W; i++) y[i] = x[i] + (real)0.5 * h * a[i];
                    rates(y, u, k, b);
                    for (int i = 0; i < N * W; i++) y[i] = x[i] + (real)0.5 * h * b[i];
                    rates(y, u, k, c);
                    for (int i = 0; i < N * W; i++) y[i] = x[i] + h * c[i];
                    rates(y, u, k, d);
                    for (int i = 0; i < N * W; i++) x[i] += h / 6 * (a[i] + d[i] + 2 * (b[i] + c[i]));
                }
                for (int s = 0; s < n_stops; s++) {
                    real *place = x + position[s] * W, *speed = x + rate[s] * W;
                    for (int r = 0; r < W; r++) {
                        int below = place[r] <= low[s], above = place[r] >= high[s];
                        int outward = (below && speed[r] < 0) || (above && speed[r] > 0);
                        at[r] |= below | above;
                        place[r] = place[r] < low[s] ? low[s] : place[r] > high[s] ? high[s] : place[r];
                        speed[r] = outward ? 0 : speed[r];
                    }
                }
                for (int r = 0; r < W && first + r < rows; r++)
                    for (int i = 0; i < N; i++)
                        out[((before + first + r) * steps + step) * N + i] = x[i * W + r];
            }
            for (int r = 0; r < W && first + r < rows; r++)
                touched[before + first + r] = (unsigned char)at[r];
        }
    }
}

/* dx/dt and its derivatives that are not zero. */
static void slopes(const real *restrict x, const real *restrict u, const real *restrict k, real *restrict f,
                   real *restrict j)
{
    for (int r = 0; r < W; r++) {
@slopes@
    }
}

static const int ROW[P] = {@slope_rows@}, COLUMN[P] = {@slope_columns@};

/* Derivative of dx/dt by where the period began, from that of x. */
static void chain(const real *restrict j, const real *restrict s, real *restrict d)
{
    for (int i = 0; i < N * C * W; i++)
        d[i] = 0;
    for (int p = 0; p < P; p++) {
        const real *restrict slope = j + p * W;
        real *restrict to = d + ROW[p] * C * W;
        if (COLUMN[p] >= N) {
            for (int r = 0; r < W; r++)
                to[COLUMN[p] * W + r] += slope[r];
            continue;
        }
        const real *restrict from = s + COLUMN[p] * C * W;
        for (int c = 0; c < C; c++)
            for (int r = 0; r < W; r++)
                to[c * W + r] += slope[r] * from[c * W + r];
    }
}

/* Derivatives of the state after such a period by the state before it and by the input; stops are left out. */
void sensitivities(long rows, const real *x0, const real *u0, const real *k, real h, int steps, real *out_x, real *out_u,
                   real *room)
{
    ARRAY(x, N * W); ARRAY(u, M * W); ARRAY(y, N * W); ARRAY(f, N * W); ARRAY(sum, N * W); ARRAY(j, P * W);
    ARRAY(s, N * C * W); ARRAY(t, N * C * W); ARRAY(d, N * C * W); ARRAY(total, N * C * W);
    const real ahead[4] = {(real)0.5 * h, (real)0.5 * h, h, 0}, whole[1] = {h};
    const real quarters[4] = {h / 6, h / 3, h / 3, h / 6}, *weight = STAGES == 1 ? whole : quarters;
    for (long first = 0; first < rows; first += W) {
        gather(x0, rows, first, N, x);
        gather(u0, rows, first, M, u);
        const int known = AFFINE && first; /* the same for all rows */
        for (int i = 0; i < N * C * W && !known; i++)
            s[i] = (i / W) % C == (i / W) / C;
        for (int step = 0; step < steps && !known; step++) {
            for (int i = 0; i < N * W; i++) { y[i] = x[i]; sum[i] = x[i]; }
            for (int i = 0; i < N * C * W; i++) { t[i] = s[i]; total[i] = s[i]; }
            for (int stage = 0; stage < STAGES; stage++) {
                slopes(y, u, k, f, j);
                chain(j, t, d);
                for (int i = 0; i < N * W; i++) {
                    y[i] = x[i] + ahead[stage] * f[i];
                    sum[i] += weight[stage] * f[i];
                }
                for (int i = 0; i < N * C * W; i++) {
                    t[i] = s[i] + ahead[stage] * d[i];
                    total[i] += weight[stage] * d[i];
                }
            }
            for (int i = 0; i < N * W; i++) x[i] = sum[i];
            for (int i = 0; i < N * C * W; i++) s[i] = total[i];
        }
        for (int r = 0; r < W && first + r < rows; r++)
            for (int i = 0; i < N; i++) {
                for (int c = 0; c < N; c++) out_x[((first + r) * N + i) * N + c] = s[(i * C + c) * W + r];
                for (int c = 0; c < M; c++) out_u[((first + r) * N + i) * M + c] = s[(i * C + N + c) * W + r];
            }
    }
}
