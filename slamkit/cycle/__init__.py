"""One step of every estimator."""
