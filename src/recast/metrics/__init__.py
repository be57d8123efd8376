"""Closed-loop metrics of rollouts, and actors against the truth where there is one."""

from recast.metrics.oracle_scores import (
    Agreement,
    AngleBin,
    OracleView,
    OracleViews,
    read_oracle_views,
)
from recast.metrics.oracle_views import TrueWorld, ViewSettings, evaluate_oracle_views, logged_views
from recast.metrics.rollout_metrics import (
    BaseMetric,
    RolloutMetric,
    RolloutMetrics,
    own_metrics,
    rollout_metrics,
)
from recast.metrics.table import (
    COLUMNS,
    Bootstrap,
    Column,
    Metric,
    PairedMetric,
    Pairs,
    TableRow,
    cluster_bootstrap,
    column_of,
    columns_of,
    exact_bootstrap,
    headlines,
    matched_pairs,
    table,
)

__all__ = [
    "COLUMNS",
    "Agreement",
    "AngleBin",
    "BaseMetric",
    "Bootstrap",
    "Column",
    "Metric",
    "OracleView",
    "OracleViews",
    "PairedMetric",
    "Pairs",
    "RolloutMetric",
    "RolloutMetrics",
    "TableRow",
    "TrueWorld",
    "ViewSettings",
    "cluster_bootstrap",
    "column_of",
    "columns_of",
    "evaluate_oracle_views",
    "exact_bootstrap",
    "headlines",
    "logged_views",
    "matched_pairs",
    "own_metrics",
    "read_oracle_views",
    "rollout_metrics",
    "table",
]
