"""Facts about the machine on which a benchmark ran."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from typing import Any


def machine() -> dict[str, Any]:
    """Processor, cores, load and versions, as JSON values."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba", "filterpy")},
    }


def sentence(facts: dict[str, Any]) -> str:
    """The facts as one sentence."""
    versions = ", ".join(f"{name} {facts[name]}" for name in ("numpy", "scipy", "numba", "filterpy"))
    load = "" if facts["load"] is None else f", load {facts['load']:g} at the start"
    return f"{facts['processor']}, {facts['cores']} cores{load}; Python {facts['python']}, {versions}"


def _processor() -> str:
    """The name of the processor if the system gives it, otherwise its architecture."""
    try:
        with open("/proc/cpuinfo") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.machine()
