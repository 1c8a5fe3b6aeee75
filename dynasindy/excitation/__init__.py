"""Signals that excite a plant for identification, usable as policies."""

from dynasindy.excitation.base import Excitation
from dynasindy.excitation.signals import Aprbs, Chirp, Multisine, Prbs, PrintedChirp, Sphs

__all__ = ["Aprbs", "Chirp", "Excitation", "Multisine", "Prbs", "PrintedChirp", "Sphs"]
