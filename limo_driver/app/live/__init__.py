"""What the network says of an arm, drawn as it comes: a page of this machine, or a log of Rerun.

`feed` keeps the latest joint state and estimate of an arm. `web` serves them with the page that
draws them (`limo watch --web`), and `rerun_log` logs them to Rerun (`limo watch --rerun`).
"""
