"""Closed-loop metrics of rollouts, and actors against the truth where there is one."""

from recast.metrics.oracle_scores import (
    Agreement,
    AngleBin,
    OracleView,
    OracleViews,
    read_oracle_views,
)
from recast.metrics.oracle_views import TrueWorld, ViewSettings, evaluate_oracle_views, logged_views
from recast.metrics.rollout_metrics import RolloutMetrics, rollout_metrics
from recast.metrics.table import (
    COLUMNS,
    Bootstrap,
    Column,
    Metric,
    PairedMetric,
    Pairs,
    TableRow,
    cluster_bootstrap,
    exact_bootstrap,
    matched_pairs,
    table,
)

__all__ = [
    "COLUMNS",
    "Agreement",
    "AngleBin",
    "Bootstrap",
    "Column",
    "Metric",
    "OracleView",
    "OracleViews",
    "PairedMetric",
    "Pairs",
    "RolloutMetrics",
    "TableRow",
    "TrueWorld",
    "ViewSettings",
    "cluster_bootstrap",
    "evaluate_oracle_views",
    "exact_bootstrap",
    "logged_views",
    "matched_pairs",
    "read_oracle_views",
    "rollout_metrics",
    "table",
]
