"""A finished controller as a user holds it: measurements and a reference in, inputs out, and a file of its own."""

from dynasindy.control.controller import Controller
from dynasindy.control.files import load, save

__all__ = ["Controller", "load", "save"]
