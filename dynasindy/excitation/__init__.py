"""Signals that excite a plant for identification, usable as policies."""

from dynasindy.excitation.base import Excitation
from dynasindy.excitation.chirp import Chirp, PrintedChirp, SquaredChirp
from dynasindy.excitation.harmonic import Multisine, Sphs
from dynasindy.excitation.switching import Aprbs, Prbs

__all__ = ["Aprbs", "Chirp", "Excitation", "Multisine", "Prbs", "PrintedChirp", "Sphs", "SquaredChirp"]
