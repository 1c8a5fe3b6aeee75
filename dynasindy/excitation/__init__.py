"""Signals that excite a plant for identification, usable as policies."""

from dynasindy.excitation.base import Excitation
from dynasindy.excitation.signals import Aprbs, Chirp, Multisine

__all__ = ["Aprbs", "Chirp", "Excitation", "Multisine"]
