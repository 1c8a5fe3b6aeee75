"""SysIdentPy's polynomial NARX by FROLS: degree, lags and terms chosen on the last quarter of the log."""

import itertools
import warnings
from importlib.metadata import version

import numpy as np
from serve import answer, cpu_seconds, settings

warnings.filterwarnings("ignore")


def main():
    """Search, fit to the whole log, and answer with the simulation of the test log."""
    asked = settings()
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    start = cpu_seconds()
    u, y, u_test, y_test = (np.array(asked[name]) for name in ("u", "y", "u_test", "y_test"))
    cut, best = int(0.75 * len(y)), None

    def model(degree, lag, terms):
        lags = {"ylag": lag, "xlag": lag if u.shape[1] == 1 else [list(range(1, lag + 1))] * u.shape[1]}
        basis, estimator = Polynomial(degree=degree), LeastSquares()
        return FROLS(order_selection=False, n_terms=terms, estimator=estimator, basis_function=basis, **lags)

    for degree, lag, terms in itertools.product((1, 2, 3), (2, 3, 4, 6), (4, 6, 8, 12, 16, 24)):
        if degree == 3 and lag > 3:
            continue
        try:
            tried = model(degree, lag, terms)
            tried.fit(X=u[:cut], y=y[:cut])
            found = tried.predict(X=u[cut - lag :], y=y[cut - lag : cut])[lag:]
            error = float(np.sqrt(np.mean((found - y[cut:]) ** 2)))
        except Exception:  # more terms than there are, or numbers beyond all limits
            continue
        if np.isfinite(error) and (best is None or error < best[0]):
            best = error, (degree, lag, terms)
    chosen = model(*best[1])
    chosen.fit(X=u, y=y)
    lag = best[1][1]
    found = chosen.predict(X=u_test, y=y_test[:lag])
    found[:lag] = y_test[:lag]
    answer(version=version("sysidentpy"), cpu=cpu_seconds() - start, chosen=best[1], found=found.tolist())


if __name__ == "__main__":
    main()
