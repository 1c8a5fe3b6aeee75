"""One control period of machine code, as of many that follow each other."""


def one_period(code, x, u, *settings):
    samples, touched = code.flight(x, u.unsqueeze(0), *settings)
    return samples[0], touched[0]
