"""A finished controller as a user holds it: measurements and a reference in, inputs out, and a file of its own.

With it the observer that makes states of measurements, and the sensing of a plant in simulation.
"""

from dynasindy.control.controller import Controller, load, save
from dynasindy.control.observer import Observer

__all__ = ["Controller", "Observer", "load", "save"]
