"""Sparse models of controlled systems, identified from transitions.

| name              | what it is wherever nothing else is said                                | shape               |
| ----------------- | ----------------------------------------------------------------------- | ------------------- |
| library           | candidate functions, with the numbers inside them                       | n_features          |
| xi, coefficients  | Xi, of rates of change                                                  | `(n_features, n_x)` |
| free, support     | coefficients that may be estimated; that are in the equations           | bool, the same      |
| theta, dx         | averaged functions and rates of change, a row a sample                  | `(N, ...)`          |
| data              | the recording under zero-order hold, NaN where a state was not measured | N rows              |
| guess             | the same, states that were not measured guessed                         | N rows              |
| rates, followers  | which state is the rate of which other one, and follows which other one | `{this: other}`     |
| windows, joined   | W stretches of L intervals, and which of them continue the one before   | `(W,)`              |
| error, mask, seen | what a model leaves over, and 1 where a state was measured, else 0      | `(W, L, n_x)`       |
| sigma             | error of each state, the weights of a fit                               | `(n_x,)`            |
| triangle          | R of [columns, target], weighted                                        | `(n + 1, n + 1)`    |
| tolerance         | part of a rate of change that may stay unexplained of what is exact     |                     |
"""

from dynasindy.sindy.fit_report import FitReport
from dynasindy.sindy.functions import register_function
from dynasindy.sindy.learned_reward import LearnedReward
from dynasindy.sindy.library import Library
from dynasindy.sindy.model import SindyModel
from dynasindy.sindy.named_libraries import build_library
from dynasindy.sindy.refinement import Refinement
from dynasindy.sindy.regression import Regression
from dynasindy.sindy.world_model import Oracle, WorldModel

__all__ = [
    "FitReport",
    "LearnedReward",
    "Library",
    "Oracle",
    "Refinement",
    "Regression",
    "SindyModel",
    "WorldModel",
    "build_library",
    "register_function",
]
