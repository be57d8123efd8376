"""The whole job in steps that resume: log to scene, actor, rollouts, metrics, report."""
