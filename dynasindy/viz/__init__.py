"""Figures of a run, one function per figure, from plain arrays; each returns a matplotlib `Figure`."""
