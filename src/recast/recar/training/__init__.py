"""Training that resumes bit for bit, and the flow-matching tasks of the two-stage adaptation.

`loop.train` trains any task; `stage.train_stage` runs a stage from a model folder to a new one.
"""
