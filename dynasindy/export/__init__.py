"""Controllers and models in other languages: C99, ONNX, FMI, CasADi, SymPy and LaTeX."""

from dynasindy.control.c_code import Native, controller_sources, model_sources

__all__ = ["Native", "controller_sources", "model_sources"]
