"""The steps of `limo doctor` to the first motion of a real arm; each may refuse the next.

`records` says which step may come; `arms` how the arm of each backend is reached; `watching` what
an arm shows that nobody commands, also a shadow of it, whose commands are computed and go nowhere;
`gravity` whether its torques are those of the one described; `motions` are those that are shadowed
and then made; `steps` takes one step, and `page` shows it.
"""
