"""Runs in lockstep: what all of them do at the same time is done at once, as one batch, on one device."""

from dynasindy.together.company import Carried, Company, here
from dynasindy.together.flights import EPISODE, fly, replay
from dynasindy.together.learning import learn

__all__ = ["EPISODE", "Carried", "Company", "fly", "here", "learn", "replay"]
