"""The training loop that resumes bit for bit; `loop.train` trains any task.

`task` says what is trained and by which settings, `state` is all that a training changes.
"""
