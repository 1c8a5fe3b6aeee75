"""Stored experience."""

from dynasindy.data.replay import LEARN_KEYS, MEASURED_KEYS, REAL_KEYS, DynaReplay

__all__ = ["LEARN_KEYS", "MEASURED_KEYS", "REAL_KEYS", "DynaReplay"]
