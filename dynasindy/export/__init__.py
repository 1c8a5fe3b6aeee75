"""Controllers and models in other languages: C99, ONNX, FMI, CasADi, SymPy, LaTeX and python-control."""

from dynasindy.export.c_code import controller_sources, model_sources

__all__ = ["controller_sources", "model_sources"]
