"""The commands as functions on values: plan, excite, run, identify, predict, train, ...

This is where the parts meet; `limo_driver` exports each function by its name, and each command is
options → function → print. A function imports what it needs when it is called.
"""
