"""Monte Carlo studies: run many filters over the same simulated runs, or one recorded log, and compare them."""

from slamkit.study.compare import compare, prepare, run_trial
from slamkit.study.gauge_check import GAUGE_COVARIANCE, GAUGE_MOTION, GaugeCheck
from slamkit.study.study import Study
from slamkit.study.trial import Trial

__all__ = ["GAUGE_COVARIANCE", "GAUGE_MOTION", "GaugeCheck", "Study", "Trial", "compare", "prepare", "run_trial"]
