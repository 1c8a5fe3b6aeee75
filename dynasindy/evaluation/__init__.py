"""How good a controller is: tracking metrics, statistics over seeds, and fixed scenarios."""
