"""Training that resumes bit for bit, and the flow-matching tasks of the two-stage adaptation."""
