"""The training loop that resumes bit for bit: task, data order, moving average, clipping, states.

`loop.train` trains any task: the two-stage adaptation of `recast.recar`, small models, planners.
"""
