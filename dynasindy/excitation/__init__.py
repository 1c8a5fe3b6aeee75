"""Signals that excite a plant for identification, usable as policies."""

from dynasindy.excitation.signals import Aprbs, Chirp, Excitation, Multisine

__all__ = ["Aprbs", "Chirp", "Excitation", "Multisine"]
