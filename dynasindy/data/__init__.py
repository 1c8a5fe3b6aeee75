"""Stored experience."""

from dynasindy.data.replay import LEARN_KEYS, REAL_KEYS, DynaReplay

__all__ = ["LEARN_KEYS", "REAL_KEYS", "DynaReplay"]
