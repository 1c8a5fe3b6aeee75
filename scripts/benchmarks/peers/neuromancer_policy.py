"""NeuroMANCER's differentiable predictive control through the exported model: as its documents have it, or helped.

As documented: quadratic penalties, AdamW at 2e-3, windows of 50 periods from 2000 random starts, batches of 200. Helped
by what dynasindy does: its cost, windows that go on where the last ones ended, Adam from 1e-2 down a cosine, gradients
clipped at .3.
"""

import math
import sys
import types
from importlib.metadata import version

import torch
from serve import answer, control, cpu_seconds, field_of, settings

sys.modules["wandb"] = types.ModuleType("wandb")  # imported by a logger that nothing here uses

CALLS = {name: getattr(torch, name) for name in ("cos", "sin", "exp", "sign", "sqrt", "tanh", "square")}
WINDOW, BATCH, EPISODE, STARTS = {False: 50, True: 60}, {False: 200, True: 128}, 20.0, 2000


def main():
    """Train, then fly."""
    asked = settings()
    from neuromancer.constraint import Variable, variable
    from neuromancer.dynamics import integrators, ode
    from neuromancer.loss import PenaltyLoss
    from neuromancer.modules import blocks
    from neuromancer.problem import Problem
    from neuromancer.system import Node, System

    torch.set_num_threads(1)
    torch.manual_seed(asked["seed"])
    start, helped, dt = cpu_seconds(), asked["kind"] == "helped", asked["dt"]
    sizes = torch.tensor(asked["ranges"])
    low, high = torch.tensor(asked["low"]), torch.tensor(asked["high"])
    rates_of = field_of(asked["field"], CALLS | {"fabs": torch.abs, "larger": torch.maximum})
    n_x, n_u, n_r = len(sizes), asked["n_u"], len(low)
    window, batch = WINDOW[helped], BATCH[helped]

    class Plant(ode.ODESystem):
        def __init__(self):
            super().__init__(insize=n_x + n_u, outsize=n_x)

        def ode_equations(self, x, u):
            return torch.stack(rates_of((x * sizes).unbind(-1), u.unbind(-1)), -1) / sizes

    class Policy(torch.nn.Module):
        def __init__(self):
            super().__init__()
            kind = torch.nn.LeakyReLU if helped else torch.nn.GELU
            shape = {"insize": n_x + n_r, "outsize": n_u, "hsizes": [128, 128], "nonlin": kind}
            self.net = blocks.MLP_bounds(**shape, min=-1.0, max=1.0, method="sigmoid_scale")

        def forward(self, x, r):
            return self.net(torch.cat([x, (r - x[..., :n_r]) / 0.5], -1))

    policy = Policy()
    model = Node(integrators.RK4(Plant(), h=torch.tensor(dt)), ["x", "u"], ["x"], name="model")
    loop = System([Node(policy, ["x", "r"], ["u"], name="policy"), model], nsteps=window, name="loop")
    x, r = variable("x"), variable("r")
    if helped:

        def cost(x, r):
            error = x[:, 1:, :n_r] - r[:, 1:]
            turning = (x[:, 1:, n_r : 2 * n_r] - x[:, :-1, n_r : 2 * n_r]).square()
            return 4 * (error.square() / (0.02 + error.abs())).sum(-1) + 0.1 * turning.sum(-1)

        loss = PenaltyLoss([Variable([x, r], func=cost, display_name="cost").minimize(weight=1.0, name="cost")], [])
    else:
        tracking = 5.0 * ((x[:, 1:, :n_r] == r[:, 1:, :]) ^ 2)
        turning = Variable([x], func=lambda x: (x[:, 1:, n_r : 2 * n_r] - x[:, :-1, n_r : 2 * n_r]).square())
        loss = PenaltyLoss([turning.minimize(weight=0.1, name="turning")], [tracking])
    problem = Problem([loop], loss)
    rate = 1e-2 if helped else 2e-3
    optimizer = (torch.optim.Adam if helped else torch.optim.AdamW)(problem.parameters(), lr=rate)
    rng = torch.Generator().manual_seed(asked["seed"])

    def targets(n):
        return low + (high - low) * torch.rand(n, n_r, generator=rng)

    def starts(n):
        place = torch.zeros(n, n_x)
        place[:, :n_r] = targets(n)
        place[:, n_r : 2 * n_r] = 0.3 * torch.randn(n, n_r, generator=rng)
        place[:, 2 * n_r :] = 0.4 * torch.randn(n, n_x - 2 * n_r, generator=rng)
        place[::2] = 0.0
        return place

    pool = (starts(STARTS), targets(STARTS))
    now, wanted, age = torch.zeros(batch, n_x), targets(batch), EPISODE * torch.rand(batch, generator=rng)
    for update in range(asked["updates"]):
        if helped:
            share = 0.5 * (1 + math.cos(math.pi * update / asked["updates"]))
            optimizer.param_groups[0]["lr"] = rate * (0.01 + 0.99 * share)
        else:
            chosen = torch.randint(STARTS, (batch,), generator=rng)
            now, wanted = (part[chosen] for part in pool)
        data = {"x": now.unsqueeze(1), "r": wanted.unsqueeze(1).expand(-1, window + 1, -1), "name": "train"}
        found = problem(data)
        optimizer.zero_grad()
        found["train_loss"].backward()
        norm = torch.nn.utils.clip_grad_norm_(problem.parameters(), 0.3 if helped else 100.0)
        if norm.isfinite():
            optimizer.step()
        last, age = found["train_x"][:, -1].detach(), age + window * dt
        ended = ((age >= EPISODE) | ~(last.abs() < 100).all(-1)).unsqueeze(-1)
        # Of episodes that begin anew a quarter goes on, with another target, and a quarter begins anywhere.
        chance = torch.rand(batch, 1, generator=rng)
        anew = torch.where(chance > 0.75, last.nan_to_num(0.0, 0.0, 0.0).clamp(-100, 100), torch.zeros(batch, n_x))
        anew = torch.where(chance < 0.25, starts(batch), anew)
        now, wanted = torch.where(ended, anew, last), torch.where(ended, targets(batch), wanted)
        age = torch.where(ended.squeeze(-1), torch.zeros(batch), age)
    answer(version=version("neuromancer"), cpu=cpu_seconds() - start)

    @torch.no_grad()
    def act(x, r, first, flight):
        return policy(torch.tensor(x).float() / sizes, torch.tensor(r).float()).numpy()

    control(act)


if __name__ == "__main__":
    main()
