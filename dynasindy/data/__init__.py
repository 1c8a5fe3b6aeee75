"""Logs of plants: a reader from any file to a recording."""
