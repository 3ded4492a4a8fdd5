"""A growing Gaussian over a pose and landmarks. It knows linear algebra and no robot."""

from slamkit.belief.belief import Belief
from slamkit.belief.compressed import undisturbed
from slamkit.belief.layout import BASE, BLOCK
from slamkit.belief.storage import Storage

__all__ = ["BASE", "BLOCK", "Belief", "Storage", "undisturbed"]
