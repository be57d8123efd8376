"""The training loop that resumes bit for bit; `loop.train` trains any task.

`loop` also says what a task is, `state` holds the settings and all that a training changes.
"""
