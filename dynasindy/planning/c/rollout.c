/* An imagined window and the adjoint equation back through it, as in planning/rollout.py, for a perceptron of
   agents/c/perceptron.c and a model whose machine code is `advance` of systems/c/period.c. Observations are linear in the
   states. Numbers lie row by row, as torch stores them; a window is its periods one after another. */

typedef void Advance(long periods, long rows, const float *x, const float *u, const float *constants, float h, int steps,
                     int n_stops, const int *position, const int *rate, const float *low, const float *high, float *out,
                     unsigned char *touched, float *room);

typedef struct {
    long periods, rows, rest_jump; /* from the inputs at rest of a period to those of the next */
    int n_x, n_u, n_o, steps, n_stops;
    float h;
    Advance *advance;
    const float *constants;
    const int *position, *rate;
    const float *low, *high;
    float *room;
    const float *slope;                                /* of the observations by the states, (n_o, n_x) */
    const float *late;                                 /* share of each action that acts a period later; or NULL */
    const float *rest, *factor, *limits;              /* how strong inputs are, about what, and their ends; or NULL */
} Rollout;

/* Numbers that the layers of a period take. */
long layers_size(const Network *policy, long rows)
{
    long numbers = 0;
    for (int l = 0; l <= policy->depth; l++)
        numbers += (panels_of(rows) * policy->widths[l] * P + 15) / 16 * 16;
    return numbers;
}

/* Numbers of room that the two functions below need. */
long room_size(const Rollout *r, const Network *policy)
{
    long panels = panels_of(r->rows), most = (widest(policy) + P) / P * P;
    return 3 * panels * P * most + r->rows * (r->n_x * (r->steps + 2) + r->n_o + 3 * r->n_u + 1) + 16 * 12;
}

/* Actions of the policy, the hyperbolic tangent of its outputs; its layers are kept. */
static void act(const Network *policy, long rows, const float *observation, float *kept, float *action)
{
    int depth = policy->depth, n_u = policy->widths[depth];
    float *layers[depth + 1];
    reserve(policy, panels_of(rows), layers, &kept);
    enter(rows, policy->widths[0], observation, 0, policy->widths[0], layers[0]);
    forward(policy, 0, panels_of(rows), layers);
    for (long i = 0; i < panels_of(rows) * n_u * P; i++)
        layers[depth][i] = tanhf(layers[depth][i]);
    for (long r = 0; r < rows; r++)
        for (int i = 0; i < n_u; i++)
            action[r * n_u + i] = layers[depth][(r / P * n_u + i) * P + r % P];
}

/* From derivatives by the actions, those by the observations; those by the weights are added to `gradient`. */
static void pull_actions(const Network *policy, const Network *gradient, long rows, const float *by_action, float *kept,
                         float *room, float *by_observation)
{
    int depth = policy->depth, n = policy->widths[0], n_u = policy->widths[depth];
    long panels = panels_of(rows), most = (widest(policy) + P) / P * P;
    float *layers[depth + 1];
    reserve(policy, panels, layers, &kept);
    float *slope = take(&room, panels * P * most), *other = take(&room, panels * P * most);
    float *turned = take(&room, panels * P * most);
    enter(rows, n_u, by_action, 0, n_u, slope);
    for (long i = 0; i < panels * n_u * P; i++) /* of a hyperbolic tangent */
        slope[i] *= 1 - layers[depth][i] * layers[depth][i];
    const float *first = backward(policy, gradient, 0, panels, layers, slope, other, turned);
    pull(policy, 0, 0, panels, first, 0, n, turned);
    for (long r = 0; r < rows; r++)
        for (int i = 0; i < n; i++)
            by_observation[r * n + i] = turned[(r / P * n + i) * P + r % P];
}

/* States, inputs that acted and actions of a window that begins at states[0], after inputs `held`.

   `free` are the observations of states of zero; `kept` holds the layers of all periods, or those of one where `jump`,
   from one period's to the next, is zero. */
void imagine(const Rollout *r, const Network *policy, const float *held, const float *free, float *states, float *applied,
             float *actions, float *kept, long jump, float *room, unsigned char *touched)
{
    int n_x = r->n_x, n_u = r->n_u, n_o = r->n_o;
    float *observed = take(&room, r->rows * n_o), *samples = take(&room, r->rows * n_x * r->steps);
    for (long k = 0; k < r->periods; k++) {
        const float *x = states + k * r->rows * n_x, *still = free + k * r->rows * n_o;
        float *next = states + (k + 1) * r->rows * n_x;
        float *u = actions + k * r->rows * n_u, *entering = applied + k * r->rows * n_u;
        for (long row = 0; row < r->rows; row++)
            for (int i = 0; i < n_o; i++) {
                float sum = still[row * n_o + i];
                for (int j = 0; j < n_x; j++)
                    sum += r->slope[i * n_x + j] * x[row * n_x + j];
                observed[row * n_o + i] = sum;
            }
        act(policy, r->rows, observed, kept + k * jump, u);
        for (long i = 0; i < r->rows * n_u; i++) {
            float v = r->late ? u[i] + r->late[i / n_u] * (held[i] - u[i]) : u[i];
            if (r->factor) {
                float rest = r->rest[k * r->rest_jump + i], low = r->limits[i % n_u], high = r->limits[n_u + i % n_u];
                v = rest + r->factor[i] * (v - rest);
                v = v < low ? low : v > high ? high : v;
            }
            entering[i] = v;
        }
        r->advance(1, r->rows, x, entering, r->constants, r->h, r->steps, r->n_stops, r->position, r->rate, r->low,
                   r->high, samples, touched, r->room);
        for (long row = 0; row < r->rows; row++)
            memcpy(next + row * n_x, samples + ((row + 1) * r->steps - 1) * n_x, sizeof(float) * (unsigned)n_x);
        held = u;
    }
}

/* Adds to `gradient` the derivatives of the cost by the weights, from those by the states, `cost`, and by the actions,
   `effort` or NULL; a and b are those of a next state by the state and by the input. */
void adjoint(const Rollout *r, const Network *policy, const Network *gradient, const float *a, const float *b,
             const float *cost, const float *effort, float *kept, long jump, float *room)
{
    int n_x = r->n_x, n_u = r->n_u, n_o = r->n_o;
    float *now = take(&room, r->rows * n_x), *before = take(&room, r->rows * n_x);
    float *by_action = take(&room, r->rows * n_u), *later = take(&room, r->rows * n_u);
    float *by_observation = take(&room, r->rows * n_o);
    memcpy(now, cost + r->periods * r->rows * n_x, sizeof(float) * (unsigned long)(r->rows * n_x));
    memset(later, 0, sizeof(float) * (unsigned long)(r->rows * n_u));
    for (long k = r->periods - 1; k >= 0; k--) {
        for (long row = 0; row < r->rows; row++) {
            const float *slope = b + (k * r->rows + row) * n_x * n_u;
            float late = r->late ? r->late[row] : 0;
            for (int j = 0; j < n_u; j++) {
                float sum = 0, *then = later + row * n_u + j;
                for (int i = 0; i < n_x; i++)
                    sum += now[row * n_x + i] * slope[i * n_u + j];
                /* An action acts in part in its own period, and for the rest in the next one. */
                float part = r->late ? sum * (1 - late) + *then : sum;
                *then = sum * late;
                by_action[row * n_u + j] = effort ? part + effort[(k * r->rows + row) * n_u + j] : part;
            }
        }
        pull_actions(policy, gradient, r->rows, by_action, kept + k * jump, room, by_observation);
        for (long row = 0; row < r->rows; row++) {
            const float *slope = a + (k * r->rows + row) * n_x * n_x, *seen = by_observation + row * n_o;
            float *to = before + row * n_x;
            memcpy(to, cost + (k * r->rows + row) * n_x, sizeof(float) * (unsigned)n_x);
            for (int i = 0; i < n_x; i++)
                for (int j = 0; j < n_x; j++)
                    to[j] += now[row * n_x + i] * slope[i * n_x + j];
            for (int i = 0; i < n_o; i++)
                for (int j = 0; j < n_x; j++)
                    to[j] += seen[i] * r->slope[i * n_x + j];
        }
        float *other = now;
        now = before, before = other;
    }
}
