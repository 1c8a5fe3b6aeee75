/* What control periods of the task of envs/task.py show and earn, row by row, operation by operation as its torch
   code has them. */
#include <math.h>

typedef @real@ real;

typedef struct {
    int n_x, n_r, n_rates, observe_rate, shape; /* of the error: 0 quadratic, 1 linear, 2 logarithmic */
    const int *outputs, *rates, *rated;         /* places of the outputs and of their rates, and whose rate each is */
    const real *scale, *unit, *error_unit, *weight;
    real rate_weight, bonus, tolerance, stop_penalty, width, dt;
} Tracking;

static const real TURN = (real)6.283185307179586;

static real cost(const Tracking *task, real error)
{
    real ratio = error / task->width;
    if (task->shape == 0)
        return error * error;
    if (task->shape == 1)
        return error * error / (task->width + (error < 0 ? -error : error));
    return task->width * @log1p@(ratio * ratio);
}

/* Of states `next`, `stride` numbers from each other, `steps` periods after their episodes began: observations, with
   references and, unless there is no room for it, what the period from x to `next` earns. */
void judge(const Tracking *task, long rows, const real *x, const real *next, long stride, const real *params,
           const long long *steps, const unsigned char *touched, float *observation, real *reference, float *reward)
{
    int n_x = task->n_x, n_r = task->n_r;
    for (long row = 0; row < rows; row++, next += stride, reference += n_r) {
        real t = (real)steps[row] * task->dt, costs = 0, changes = 0, near = 0;
        for (int i = 0; i < n_x; i++)
            *observation++ = (float)(next[i] / task->scale[i]);
        for (int j = 0; j < n_r; j++) {
            const real *p = params + (row * n_r + j) * 5;
            real angle = TURN * p[2] * t + p[3], sine = 0, jump = 0;
            if (p[1] != 0) {
                real turn = @fmod@(angle, TURN);
                sine = @sin@(angle);
                jump = (turn < 0 ? turn + TURN : turn) < TURN / 2 ? 1 : -1;
            }
            reference[j] = p[0] + p[1] * (sine + p[4] * (jump - sine));
            real error = reference[j] - next[task->outputs[j]], share = error / task->unit[j];
            *observation++ = (float)(error / task->error_unit[j]);
            costs += cost(task, share) * task->weight[j];
            near += (share < 0 ? -share : share) < task->tolerance;
        }
        for (int j = 0; task->observe_rate && j < n_r; j++) {
            const real *p = params + (row * n_r + j) * 5;
            real omega = TURN * p[2];
            *observation++ = (float)((1 - p[4]) * p[1] * omega * @cos@(omega * t + p[3]) / task->unit[j]);
        }
        if (!reward)
            continue;
        for (int j = 0; j < task->n_rates; j++) {
            real change = (next[task->rates[j]] - x[row * n_x + task->rates[j]]) / task->unit[task->rated[j]];
            changes += change * change;
        }
        real paid = -costs - task->rate_weight * changes + task->bonus * near;
        reward[row] = (float)(paid - task->stop_penalty * (real)touched[row]);
    }
}
