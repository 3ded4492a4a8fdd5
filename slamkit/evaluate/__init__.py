"""How good an estimate is, and how well it knows."""
