/* Perceptrons of LeakyReLU on the CPU: their layers, and the derivatives of these by hand.

   A batch is cut into panels of P rows, the last filled up with zeros. A layer of n units is held as n * P numbers a
   panel, unit by unit, so that one instruction works on several rows, whatever the width. */
#include <math.h>
#include <string.h>

#if defined(__AVX512F__)
#define LANES 16
#elif defined(__AVX__)
#define LANES 8
#else
#define LANES 4
#endif
#define INLINE static inline __attribute__((always_inline))
enum { P = 2 * LANES, AT_ONCE = 8 }; /* AT_ONCE * 2 sums fit into the registers */
typedef float vec __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

/* Element (m, k) of a matrix lies at a[m * row + k * col], where k runs over `outer` blocks of `inner`. */
typedef struct {
    const float *a;
    long row, col, jump; /* from one m to the next, from one k to the next, from one block to the next */
    int outer, inner;
} Factor;

static const float SLOPE = 0.01f; /* of a LeakyReLU below zero */

typedef struct {
    int depth;         /* layers */
    const int *widths; /* of inputs, hidden layers and outputs: depth + 1 */
    float **weight;    /* (nets, n_out, n_in) of each layer */
    float **bias;      /* (nets, n_out) */
} Network;

static long panels_of(long rows) { return (rows + P - 1) / P; }
static float *take(float **work, long numbers) /* numbers begin at cache lines, as `work` does */
{
    float *taken = *work;
    *work += (numbers + 15) / 16 * 16;
    return taken;
}

/* ---- products of matrices: out[m] = sum_k a(m, k) x[k] for rows m of a factor and panels x of P columns ---- */

INLINE void tile(int count, int wide, Factor f, const float *x, float *out)
{
    vec sum[AT_ONCE][2];
#pragma GCC unroll 8
    for (int m = 0; m < count; m++)
#pragma GCC unroll 2
        for (int v = 0; v < wide; v++)
            sum[m][v] = (vec){0};
    for (int block = 0; block < f.outer; block++) {
        const float *a = f.a + block * f.jump;
        for (int k = 0; k < f.inner; k++, a += f.col, x += P) {
            vec right[2];
#pragma GCC unroll 2
            for (int v = 0; v < wide; v++)
                right[v] = *(const vec *)(x + v * LANES);
#pragma GCC unroll 8
            for (int m = 0; m < count; m++)
#pragma GCC unroll 2
                for (int v = 0; v < wide; v++)
                    sum[m][v] += a[m * f.row] * right[v];
        }
    }
#pragma GCC unroll 8
    for (int m = 0; m < count; m++)
#pragma GCC unroll 2
        for (int v = 0; v < wide; v++)
            *(vec *)(out + m * P + v * LANES) = sum[m][v];
}

/* As many of the next m, from `left`, as one tile takes. */
INLINE int product(int left, int wide, Factor f, const float *x, float *out)
{
    if (left >= 8) return tile(8, wide, f, x, out), 8;
    if (left >= 4) return tile(4, wide, f, x, out), 4;
    if (left >= 2) return tile(2, wide, f, x, out), 2;
    return tile(1, wide, f, x, out), 1;
}

/* ---- layers ---- */

/* Rows of numbers, as torch stores them, beside one another, into panels. */
static void enter(long rows, int n, const float *from, int first, int width, float *to)
{
    for (long p = 0; p < panels_of(rows); p++)
        for (int i = 0; i < n; i++)
            for (int j = 0; j < P; j++)
                to[(p * width + first + i) * P + j] = p * P + j < rows ? from[(p * P + j) * n + i] : 0;
}

/* Panels of units by rows into panels of rows by units. */
static void turn(long panels, int n, const float *restrict from, float *restrict to)
{
    for (int i = 0; i < n; i++)
        for (long p = 0; p < panels; p++)
            for (int j = 0; j < P; j++)
                to[((i / P * panels + p) * P + j) * P + i % P] = from[(p * n + i) * P + j];
}

/* The layers of network `net`, from its inputs in layers[0] on. */
static void forward(const Network *network, int net, long panels, float **layers)
{
    for (int l = 0; l < network->depth; l++) {
        int n = network->widths[l], out = network->widths[l + 1], last = l + 1 == network->depth;
        const float *w = network->weight[l] + (long)net * n * out, *b = network->bias[l] + (long)net * out;
        for (long p = 0; p < panels; p++) {
            const float *x = layers[l] + p * n * P;
            for (int m = 0, done; m < out; m += done) {
                float *z = layers[l + 1] + (p * out + m) * P;
                done = product(out - m, 2, (Factor){w + (long)m * n, n, 1, 0, 1, n}, x, z);
                for (int i = 0; i < done; i++)
                    for (int j = 0; j < P; j++) {
                        float y = z[i * P + j] + b[m + i];
                        z[i * P + j] = last || y > 0 ? y : SLOPE * y;
                    }
            }
        }
    }
}

/* From the derivatives by units `first`... of layer l + 1, `slope`, those by `count` units of layer l. */
static void pull(const Network *network, int net, int l, long panels, const float *slope, int first, int count,
                 float *to)
{
    int n = network->widths[l], out = network->widths[l + 1];
    const float *w = network->weight[l] + (long)net * n * out + first;
    for (long p = 0; p < panels; p++) {
        const float *x = slope + p * out * P;
        for (int m = 0, done; m < count; m += done) {
            float *z = to + (p * count + m) * P;
            done = product(count - m, 2, (Factor){w + m, 1, n, 0, 1, out}, x, z);
        }
    }
}

/* Add derivatives by weights and biases, from those by the outputs of layer l and its inputs; `turned` is room. */
static void gather(const Network *gradient, int net, int l, long panels, const float *slope, const float *inputs,
                   float *turned)
{
    int n = gradient->widths[l], out = gradient->widths[l + 1];
    float *w = gradient->weight[l] + (long)net * n * out, *b = gradient->bias[l] + (long)net * out;
    float sums[AT_ONCE * P];
    turn(panels, n, inputs, turned);
    for (int first = 0; first < n; first += P) {
        int count = n - first < P ? n - first : P;
        const float *x = turned + (long)first * panels * P;
        for (int m = 0, done; m < out; m += done) {
            Factor f = {slope + m * P, P, 1, (long)out * P, (int)panels, P};
            done = count > LANES ? product(out - m, 2, f, x, sums) : product(out - m, 1, f, x, sums);
            for (int i = 0; i < done; i++)
                for (int j = 0; j < count; j++)
                    w[(long)(m + i) * n + first + j] += sums[i * P + j];
        }
    }
    for (int m = 0; m < out; m++) {
        vec sum = {0};
        for (long p = 0; p < panels; p++)
            for (int v = 0; v < 2; v++)
                sum += *(const vec *)(slope + (p * out + m) * P + v * LANES);
        for (int v = 0; v < LANES; v++)
            b[m] += sum[v];
    }
}

/* Derivatives by the inputs of a LeakyReLU, from those by its outputs; the outputs have the signs of the inputs. */
static void bend(long numbers, const float *outputs, float *slope)
{
    for (long i = 0; i < numbers; i++)
        slope[i] *= outputs[i] > 0 ? 1 : SLOPE;
}

static void clear(const Network *gradient, int nets)
{
    for (int l = 0; l < gradient->depth; l++) {
        long n = gradient->widths[l], out = gradient->widths[l + 1];
        memset(gradient->weight[l], 0, sizeof(float) * (unsigned long)(nets * n * out));
        memset(gradient->bias[l], 0, sizeof(float) * (unsigned long)(nets * out));
    }
}

/* Add derivatives by all weights of network `net`, from those by its outputs, `slope`, unless there is no `gradient` to
   add them to; `other` and `turned` are room. Returns the derivatives by the outputs of the first layer. */
static const float *backward(const Network *network, const Network *gradient, int net, long panels, float **layers,
                             float *slope, float *other, float *turned)
{
    for (int l = network->depth - 1; l > 0; l--) {
        int n = network->widths[l];
        if (gradient) gather(gradient, net, l, panels, slope, layers[l], turned);
        pull(network, net, l, panels, slope, 0, n, other);
        bend(panels * n * P, layers[l], other);
        float *before = slope;
        slope = other, other = before;
    }
    if (gradient) gather(gradient, net, 0, panels, slope, layers[0], turned);
    return slope;
}

static int widest(const Network *network)
{
    int most = 0;
    for (int l = 0; l <= network->depth; l++)
        most = network->widths[l] > most ? network->widths[l] : most;
    return most;
}

static void reserve(const Network *network, long panels, float **layers, float **work)
{
    for (int l = 0; l <= network->depth; l++)
        layers[l] = take(work, panels * network->widths[l] * P);
}
