/* One update of TD3 on the CPU: losses and their gradients by hand, and Adam, on the networks of perceptron.c. */

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
    clear(&agent->critic_gradient, agent->critics);
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
    const float *first = backward(&agent->critic, NULL, 0, panels, layers, slope, other, NULL);
    pull(&agent->critic, 0, 0, panels, first, n_obs, n_u, turned);
    for (long i = 0; i < panels * n_u * P; i++) /* of a hyperbolic tangent */
        turned[i] *= 1 - acting[depth][i] * acting[depth][i];
    clear(&agent->actor_gradient, 1);
    backward(&agent->actor, &agent->actor_gradient, 0, panels, acting, turned, slope, other);
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
