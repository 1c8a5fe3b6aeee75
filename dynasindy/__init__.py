"""Dyna-style reinforcement learning with identified SINDy world models, built on TorchRL.

Importing the package imports no heavy library; each subpackage imports what it needs.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"
