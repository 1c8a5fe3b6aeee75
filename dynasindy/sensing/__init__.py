"""What is measured of the real plant, and the states that an observer makes of it."""

from dynasindy.sensing.observer import Observer
from dynasindy.sensing.sensors import Channel, Sensors
from dynasindy.sensing.transform import Sensing

__all__ = ["Channel", "Observer", "Sensing", "Sensors"]
