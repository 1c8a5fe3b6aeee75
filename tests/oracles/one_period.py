"""Control periods of machine code: many that follow each other, and one of them."""

import torch

from dynasindy.systems.steps import steps_of


def flight(code, x, u, dt, substeps, stops=None):
    samples = x.new_empty(*u.shape[:-1], steps_of(code.step, dt, substeps).number, x.shape[-1])
    touched = torch.empty(u.shape[:-1], dtype=torch.bool)
    code.bind(x.contiguous(), u.contiguous(), samples, touched, dt, substeps, stops)()
    return samples, touched


def one_period(code, x, u, *settings):
    samples, touched = flight(code, x, u.unsqueeze(0), *settings)
    return samples[0], touched[0]
