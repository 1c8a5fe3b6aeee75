"""do-mpc's controllers on the exported model: NMPC as written or helped, and the network that imitates it."""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from serve import answer, control, cpu_seconds, field_of, settings

sys.path.append(str(Path(__file__).resolve().parents[2]))

LOW, HIGH = [-1.2, -1.2, -2.5, -2.5, -4000, -2500, -0.5, -0.5], [1.2, 1.2, 2.5, 2.5, 4000, 4000, 0.5, 0.4]
"""Ranges of states and targets to which the network scales."""
FROM, TO = [-0.5, -0.5, -0.3, -0.3, -1500, -500, -0.5, -0.5], [0.5, 0.4, 0.3, 0.3, 1500, 2500, 0.5, 0.4]
"""Ranges in which the sampled trajectories begin."""


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
    from benchmarks.nmpc import Pilot, Plan, build, functions

    start = cpu_seconds()
    helped = asked["kind"] != "written"
    plan = Plan(**({**asked["plan"]} if helped else {**asked["plan"], "hint": {}, "guess": {}}))
    rates_of = field_of(asked["field"], functions(dict(zip(plan.states, plan.ranges)) if helped else {}))
    if asked["kind"] != "approx":
        pilot = Pilot(rates_of, plan)
        answer(version=version("do-mpc"), cpu=cpu_seconds() - start)
        control(pilot.act)
        return
    mpc = build(rates_of, plan)
    names = [*plan.states, *(f"r_{k}" for k in range(len(plan.outputs)))]
    for name, low, high in zip(names, LOW, HIGH, strict=True):
        mpc.bounds["lower", "_x", name], mpc.bounds["upper", "_x", name] = low, high
    mpc.setup()
    network = imitate(mpc, names, asked["trajectories"], asked["length"], asked["epochs"], asked["folder"])
    answer(version=version("do-mpc"), cpu=cpu_seconds() - start)
    before = {}

    def act(x, r, first, flight):
        last = np.zeros((len(plan.inputs), 1)) if first else before[flight]
        state = np.concatenate([x, r]).reshape(-1, 1)
        before[flight] = np.asarray(network.make_step(state, u_prev=last, clip_to_bounds=False)).reshape(-1, 1)
        return before[flight]

    control(act)


if __name__ == "__main__":
    main()
