"""Closed-loop metrics of rollouts, their table and their confidence."""

from recast.evaluation.bootstrap import Bootstrap, cluster_bootstrap, exact_bootstrap
from recast.evaluation.metric import Metric
from recast.evaluation.rollout_metrics import RolloutMetrics, rollout_metrics
from recast.evaluation.table import COLUMNS, Column, TableRow, paired_differences, table

__all__ = [
    "COLUMNS",
    "Bootstrap",
    "Column",
    "Metric",
    "RolloutMetrics",
    "TableRow",
    "cluster_bootstrap",
    "exact_bootstrap",
    "paired_differences",
    "rollout_metrics",
    "table",
]
