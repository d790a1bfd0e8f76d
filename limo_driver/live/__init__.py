"""The live page of an arm: what the network says of it, in a browser of the same machine.

`feed` keeps the latest joint state and estimate of an arm, and `web` serves them with the page that
draws them; `limo watch --web` opens both.
"""
