"""do-mpc's controllers on the exported model: NMPC as written or helped, and the network that imitates it.

| name     | symbol   | equation                                                                              |
| -------- | -------- | ------------------------------------------------------------------------------------- |
| model    | f        | dx/dt = f(x, u), collocated by do-mpc                                                  |
| stage    | l        | 4 (y - r)^2 + .02 (dy/dt)^2 + .002 ((x - h(r)) / range)^2, .001 of squared changes of u |
| terminal | m        | 10 times the squared errors, and .1 of the squared rates                               |

The hint h(r) is where the states that have no target rest while the outputs are at r. Without it, and with magnitudes
that have a corner, IPOPT can call plans solved that leave a rotor standing, where its thrust w |w| has no slope.
"""

from importlib.metadata import version

import casadi
import do_mpc
import numpy as np
from serve import answer, control, cpu_seconds, field_of, monomials, settings

HORIZON = 40
"""Periods that are planned."""
LOW, HIGH = [-1.2, -1.2, -2.5, -2.5, -4000, -2500, -0.5, -0.5], [1.2, 1.2, 2.5, 2.5, 4000, 4000, 0.5, 0.4]
"""Ranges of states and targets to which the network scales."""
FROM, TO = [-0.5, -0.5, -0.3, -0.3, -1500, -500, -0.5, -0.5], [0.5, 0.4, 0.3, 0.3, 1500, 2500, 0.5, 0.4]
"""Ranges in which the sampled trajectories begin."""


def functions(sizes):
    """Return what formulas call; magnitudes of states with a size are smooth, rounded within a 2500th of it."""
    calls = {name: getattr(casadi, name) for name in ("sin", "cos", "exp", "tanh", "sqrt", "sign", "fabs")}

    def magnitude(a):
        if not a.is_symbolic() or a.name() not in sizes:
            return casadi.fabs(a)
        corner = sizes[a.name()] / 2500
        return casadi.sqrt(a * a + corner**2) - corner

    if sizes:
        calls["fabs"] = magnitude
    exceeds = {"exceeds": lambda a, b: casadi.if_else(a > b, 1.0, 0.0)}
    return {**calls, **exceeds, "square": lambda a: a * a, "larger": casadi.fmax}


def build(rates_of, plan):
    """Return a controller of do-mpc, before its setup; its states are those of the plan and `r_0`, `r_1`, ..."""
    model = do_mpc.model.Model("continuous")
    x = [model.set_variable("_x", name) for name in plan["states"]]
    u = [model.set_variable("_u", name) for name in plan["inputs"]]
    r = [model.set_variable("_x", f"r_{k}") for k in range(len(plan["outputs"]))]
    for name, rate in zip(plan["states"], rates_of(x, u), strict=True):
        model.set_rhs(name, rate)
    for k in range(len(r)):
        model.set_rhs(f"r_{k}", casadi.DM(0))
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    asked = mpc.settings
    asked.n_horizon, asked.t_step, asked.n_robust, asked.store_full_solution = HORIZON, plan["dt"], 0, False
    asked.supress_ipopt_output()
    at, size = dict(zip(plan["states"], x, strict=True)), dict(zip(plan["states"], plan["ranges"], strict=True))
    errors = sum((at[name] - to) ** 2 for name, to in zip(plan["outputs"], r, strict=True))
    speeds = sum(at[name] ** 2 for name in plan["rates"])
    squares = {name: sum(c * m for c, m in zip(of, monomials(r), strict=True)) for name, of in plan["hint"].items()}
    rest = {name: of / (of * of + 1.0) ** 0.25 for name, of in squares.items()}
    track = 4 * errors + 0.002 * sum(((at[name] - to) / size[name]) ** 2 for name, to in rest.items())
    mpc.set_objective(mterm=10 * track + 0.1 * speeds, lterm=track + 0.02 * speeds)
    mpc.set_rterm(**dict.fromkeys(plan["inputs"], 1e-3))
    for name in plan["inputs"]:
        mpc.bounds["lower", "_u", name], mpc.bounds["upper", "_u", name] = -1, 1
    for name, of in size.items():
        mpc.scaling["_x", name] = of
    return mpc


class Pilot:
    """Flies several flights in turn: what do-mpc keeps from period to period is kept for each."""

    def __init__(self, rates_of, plan):
        self.plan, self.mpc, self.flights = plan, build(rates_of, plan), {}
        self.mpc.setup()

    def act(self, x, target, first, flight):
        """Return the inputs; a plan that is not solved is followed, and the next one begins anew."""
        state = np.concatenate([x, target])
        if first:
            start = state.copy()
            for name, of in (*zip(self.plan["outputs"], target, strict=True), *self.plan["guess"].items()):
                start[self.plan["states"].index(name)] = of
            self.mpc.reset_history()
            self.mpc.x0, self.mpc.u0 = start, np.zeros((len(self.plan["inputs"]), 1))
            self.mpc.set_initial_guess()
        else:
            self.mpc.opt_x_num.master, self.mpc._u0.master = self.flights[flight]
        u = self.mpc.make_step(state.reshape(-1, 1))
        if not self.mpc.solver_stats["success"]:
            self.mpc.x0 = state
            self.mpc.set_initial_guess()
        self.flights[flight] = (self.mpc.opt_x_num.master, self.mpc._u0.master)
        return np.asarray(u, dtype=float).ravel()


def imitate(mpc, names, trajectories, length, epochs, folder):
    """Return a network that was trained on closed loops of the controller."""
    import torch
    from do_mpc.approximateMPC import AMPCSampler, ApproxMPC, Trainer

    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002, which do-mpc draws from
    mpc.x0 = np.zeros(len(names))
    mpc.set_initial_guess()
    network, sampler = ApproxMPC(mpc), AMPCSampler(mpc)
    network.settings.n_hidden_layers, network.settings.n_neurons, network.settings.device = 2, 128, "cpu"
    network.setup()
    begin, asked = cpu_seconds(), sampler.settings
    asked.closed_loop_flag, asked.trajectory_length, asked.n_samples = True, length, trajectories
    asked.dataset_name, asked.data_dir = "plant", folder
    asked.lbx, asked.ubx = np.array(FROM).reshape(-1, 1), np.array(TO).reshape(-1, 1)
    sampler.setup()
    sampler.default_sampling()
    sampled, trainer = cpu_seconds(), Trainer(network)
    asked = trainer.settings
    asked.dataset_name, asked.data_dir, asked.results_dir = "plant", folder, f"{folder}/out"
    asked.n_epochs, asked.batch_size, asked.learning_rate, asked.scheduler_flag = epochs, 1000, 2e-3, True
    trainer.scheduler_settings.patience = 50
    trainer.setup()
    trainer.default_training()
    print(f"samples {sampled - begin:.1f} s, training {cpu_seconds() - sampled:.1f} s")
    return network


def main():
    """Build what is asked for, then fly."""
    asked = settings()
    start, plan, sizes = cpu_seconds(), asked["plan"], {}
    if asked["kind"] == "written":
        plan |= {"hint": {}, "guess": {}}
    else:
        sizes = dict(zip(plan["states"], plan["ranges"], strict=True))
    rates_of = field_of(asked["field"], functions(sizes))
    if asked["kind"] != "approx":
        pilot = Pilot(rates_of, plan)
        answer(version=version("do-mpc"), cpu=cpu_seconds() - start)
        control(pilot.act)
        return
    mpc = build(rates_of, plan)
    names = [*plan["states"], *(f"r_{k}" for k in range(len(plan["outputs"])))]
    for name, low, high in zip(names, LOW, HIGH, strict=True):
        mpc.bounds["lower", "_x", name], mpc.bounds["upper", "_x", name] = low, high
    mpc.setup()
    network = imitate(mpc, names, asked["trajectories"], asked["length"], asked["epochs"], asked["folder"])
    answer(version=version("do-mpc"), cpu=cpu_seconds() - start)
    before = {}

    def act(x, r, first, flight):
        last = np.zeros((len(plan["inputs"]), 1)) if first else before[flight]
        state = np.concatenate([x, r]).reshape(-1, 1)
        before[flight] = np.asarray(network.make_step(state, u_prev=last, clip_to_bounds=False)).reshape(-1, 1)
        return before[flight]

    control(act)


if __name__ == "__main__":
    main()
