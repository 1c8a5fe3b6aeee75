"""One control period of machine code."""

import torch

from dynasindy.systems.steps import steps_of


def one_period(code, x, u, dt, substeps, stops=None):
    samples = x.new_empty(1, *u.shape[:-1], steps_of(code.step, dt, substeps).number, x.shape[-1])
    touched = torch.empty(1, *u.shape[:-1], dtype=torch.bool)
    code.bind(x.contiguous(), u.unsqueeze(0).contiguous(), samples, touched, dt, substeps, stops)()
    return samples[0], touched[0]
