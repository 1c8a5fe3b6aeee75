/* One update of TD3 on the CPU: losses and their gradients by hand, and Adam. Networks are perceptrons of LeakyReLU.

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

typedef struct {
    int n_obs, n_u, critics;
    float gamma, sigma, clip;
    Network actor, critic, target_actor, target_critic, actor_gradient, critic_gradient;
} Agent;

typedef struct {
    long rows;
    const float *observation, *action, *next_observation, *reward, *noise; /* row by row, as torch stores them */
    const unsigned char *terminated;
} Batch;

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

/* LANES times LANES numbers, rows into columns: where row i and row i + LANES / 2 are dealt like cards, log2 LANES times
   over, each number ends where rows and columns are exchanged. */
INLINE void turn_tile(const float *from, float *to)
{
#if defined(__clang__)
    for (int i = 0; i < LANES; i++)
        for (int j = 0; j < LANES; j++)
            to[j * P + i] = from[i * P + j];
#else
    typedef int places __attribute__((vector_size(4 * LANES)));
    vec rows[LANES], dealt[LANES];
    places low, high;
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++) {
        low[i] = i / 2 + i % 2 * LANES;
        high[i] = low[i] + LANES / 2;
        rows[i] = *(const vec *)(from + i * P);
    }
#pragma GCC unroll 4
    for (int round = 1; round < LANES; round *= 2) {
#pragma GCC unroll 8
        for (int i = 0; i < LANES / 2; i++) {
            dealt[2 * i] = __builtin_shuffle(rows[i], rows[i + LANES / 2], low);
            dealt[2 * i + 1] = __builtin_shuffle(rows[i], rows[i + LANES / 2], high);
        }
#pragma GCC unroll 16
        for (int i = 0; i < LANES; i++)
            rows[i] = dealt[i];
    }
#pragma GCC unroll 16
    for (int i = 0; i < LANES; i++)
        *(vec *)(to + i * P) = rows[i];
#endif
}

/* Panels of units by rows into panels of rows by units, for whatever comes last up to a multiple of LANES. */
static void turn(long panels, int n, const float *from, float *to)
{
    for (int first = 0; first < n; first += LANES)
        for (long p = 0; p < panels; p++)
            for (int j = 0; j < P; j += LANES)
                turn_tile(from + (p * n + first) * P + j, to + ((first / P * panels + p) * P + j) * P + first % P);
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

/* Derivatives by weights and biases from those by the outputs of layer l and its inputs; `turned` is room. */
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
                memcpy(w + (long)(m + i) * n + first, sums + i * P, sizeof(float) * (unsigned)count);
        }
    }
    for (int m = 0; m < out; m++) {
        vec sum = {0};
        for (long p = 0; p < panels; p++)
            for (int v = 0; v < 2; v++)
                sum += *(const vec *)(slope + (p * out + m) * P + v * LANES);
        b[m] = 0;
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

/* Derivatives by all weights of network `net` from those by its outputs, `slope`; `other` and `turned` are room. */
static void backward(const Network *network, const Network *gradient, int net, long panels, float **layers,
                     float *slope, float *other, float *turned)
{
    for (int l = network->depth - 1; l >= 0; l--) {
        int n = network->widths[l];
        gather(gradient, net, l, panels, slope, layers[l], turned);
        if (!l) break;
        pull(network, net, l, panels, slope, 0, n, other);
        bend(panels * n * P, layers[l], other);
        float *before = slope;
        slope = other, other = before;
    }
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

/* Numbers of room that an update of so many rows needs. */
long room(const Agent *agent, long rows)
{
    long padded = (widest(&agent->critic) + P) / P * P + (widest(&agent->actor) + P) / P * P;
    long numbers = 1 + 3 * padded; /* target, and three of the widest */
    for (int l = 0; l <= agent->critic.depth; l++)
        numbers += agent->critic.widths[l] + agent->actor.widths[l];
    return panels_of(rows) * P * numbers + 16 * (2 * (agent->critic.depth + 1) + 4); /* and to the next cache line */
}

/* ---- losses ---- */

/* Gradients of the critics' loss, sum_i mean (Q_i(s, a) - y)^2, with y = r + gamma min_i Q'_i(s', a'), where a' is the
   target actor's with clipped noise (Fujimoto 2018, Algorithm 1). Returns the loss, and the mean of Q. */
void learn_values(const Agent *agent, const Batch *batch, float *work, double *loss, double *value)
{
    long rows = batch->rows, panels = panels_of(rows);
    int depth = agent->critic.depth, n_obs = agent->n_obs, n_u = agent->n_u, n_in = n_obs + n_u;
    float *layers[depth + 1], *acting[depth + 1];
    reserve(&agent->critic, panels, layers, &work);
    reserve(&agent->actor, panels, acting, &work);
    float *target = take(&work, panels * P);

    enter(rows, n_obs, batch->next_observation, 0, n_obs, acting[0]);
    forward(&agent->target_actor, 0, panels, acting);
    enter(rows, n_obs, batch->next_observation, 0, n_in, layers[0]);
    for (long r = 0; r < panels * P; r++)
        for (int i = 0; i < n_u; i++) {
            float noise = r < rows ? agent->sigma * batch->noise[r * n_u + i] : 0;
            noise = noise < -agent->clip ? -agent->clip : noise > agent->clip ? agent->clip : noise;
            float a = tanhf(acting[depth][(r / P * n_u + i) * P + r % P]) + noise;
            layers[0][(r / P * n_in + n_obs + i) * P + r % P] = a < -1 ? -1 : a > 1 ? 1 : a;
        }
    for (int net = 0; net < agent->critics; net++) {
        forward(&agent->target_critic, net, panels, layers);
        for (long r = 0; r < rows; r++) { /* what is no number is the smallest, as for torch */
            float q = layers[depth][r];
            target[r] = net == 0 || q < target[r] || q != q ? q : target[r];
        }
    }
    for (long r = 0; r < rows; r++)
        target[r] = batch->reward[r] + agent->gamma * (batch->terminated[r] ? 0 : target[r]);

    int most = (widest(&agent->critic) + P - 1) / P * P;
    float *slope = take(&work, panels * P * most), *other = take(&work, panels * P * most);
    float *turned = take(&work, panels * P * most);
    enter(rows, n_obs, batch->observation, 0, n_in, layers[0]);
    enter(rows, n_u, batch->action, n_obs, n_in, layers[0]);
    *loss = *value = 0;
    for (int net = 0; net < agent->critics; net++) {
        forward(&agent->critic, net, panels, layers);
        for (long r = 0; r < panels * P; r++) {
            float error = r < rows ? layers[depth][r] - target[r] : 0;
            slope[r] = 2 * error / (float)rows;
            *loss += (double)(error * error) / (double)rows;
            *value += r < rows ? (double)layers[depth][r] / (double)(rows * agent->critics) : 0;
        }
        backward(&agent->critic, &agent->critic_gradient, net, panels, layers, slope, other, turned);
    }
}

/* Gradients of the actor's loss, -mean Q_1(s, pi(s)) (Fujimoto 2018, Algorithm 1). Returns the loss. */
void learn_policy(const Agent *agent, const Batch *batch, float *work, double *loss)
{
    long rows = batch->rows, panels = panels_of(rows);
    int depth = agent->critic.depth, n_obs = agent->n_obs, n_u = agent->n_u, n_in = n_obs + n_u;
    float *layers[depth + 1], *acting[depth + 1];
    reserve(&agent->critic, panels, layers, &work);
    reserve(&agent->actor, panels, acting, &work);
    int most = (widest(&agent->critic) + P - 1) / P * P, more = (widest(&agent->actor) + P - 1) / P * P;
    most = most > more ? most : more;
    float *slope = take(&work, panels * P * most), *other = take(&work, panels * P * most);
    float *turned = take(&work, panels * P * most);

    enter(rows, n_obs, batch->observation, 0, n_obs, acting[0]);
    forward(&agent->actor, 0, panels, acting);
    enter(rows, n_obs, batch->observation, 0, n_in, layers[0]);
    for (long p = 0; p < panels; p++)
        for (int i = 0; i < n_u * P; i++) {
            float *a = acting[depth] + p * n_u * P + i;
            *a = tanhf(*a);
            layers[0][(p * n_in + n_obs) * P + i] = *a;
        }
    forward(&agent->critic, 0, panels, layers);
    *loss = 0;
    for (long r = 0; r < panels * P; r++) {
        slope[r] = r < rows ? -1 / (float)rows : 0;
        *loss -= r < rows ? (double)layers[depth][r] / (double)rows : 0;
    }
    for (int l = depth - 1; l > 0; l--) {
        int n = agent->critic.widths[l];
        pull(&agent->critic, 0, l, panels, slope, 0, n, other);
        bend(panels * n * P, layers[l], other);
        float *before = slope;
        slope = other, other = before;
    }
    pull(&agent->critic, 0, 0, panels, slope, n_obs, n_u, other);
    for (long i = 0; i < panels * n_u * P; i++) /* of a hyperbolic tangent */
        other[i] *= 1 - acting[depth][i] * acting[depth][i];
    backward(&agent->actor, &agent->actor_gradient, 0, panels, acting, other, slope, turned);
}

/* ---- steps ---- */

typedef struct {
    int tensors;
    const long *sizes;
    float **weight, **gradient, **mean, **square, **steps;
} Weights;

/* One step of Adam (Kingma and Ba 2015, Algorithm 1). */
void descend(const Weights *w, double lr, double beta_1, double beta_2, double epsilon)
{
    for (int t = 0; t < w->tensors; t++) {
        float *restrict p = w->weight[t], *restrict g = w->gradient[t], *restrict m = w->mean[t], *restrict v = w->square[t];
        double step = *w->steps[t] += 1;
        float rate = (float)(lr / (1 - pow(beta_1, step))), root = (float)(1 / sqrt(1 - pow(beta_2, step)));
        float kept = (float)beta_1, kept_square = (float)beta_2, small = (float)epsilon;
        float fresh = (float)(1 - beta_1), fresh_square = (float)(1 - beta_2);
        for (long i = 0; i < w->sizes[t]; i++) {
            m[i] = kept * m[i] + fresh * g[i];
            v[i] = kept_square * v[i] + fresh_square * g[i] * g[i];
            p[i] -= rate * m[i] / (sqrtf(v[i]) * root + small);
        }
    }
}
