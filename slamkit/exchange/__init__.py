"""Other people's file formats, in and out."""

from slamkit.exchange.tum import write_tum

__all__ = ["write_tum"]
