"""One control period of machine code."""


def one_period(code, x, u, dt, substeps, stops=None):
    samples, touched = code.advance(x, u.unsqueeze(0), dt, substeps, stops)
    return samples[0], touched[0]
