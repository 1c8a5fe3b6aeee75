"""Figures of a run, one function per figure, from plain arrays; each returns a matplotlib `Figure`."""

from dynasindy.viz.identification import coefficient_table, excitation, model_error, prediction, training_data
from dynasindy.viz.learning import average_rewards, learning_curve
from dynasindy.viz.response import error_fan, step_response, tracking
from dynasindy.viz.style import save, save_all

__all__ = [
    "average_rewards",
    "coefficient_table",
    "error_fan",
    "excitation",
    "learning_curve",
    "model_error",
    "prediction",
    "save",
    "save_all",
    "step_response",
    "tracking",
    "training_data",
]
