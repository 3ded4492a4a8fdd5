"""Readers of published data sets, one a module; each gives a :class:`slamkit.logs.Log`."""
