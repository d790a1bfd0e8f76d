from __future__ import annotations

from dataclasses import replace

from lanes import sampled
from matplotlib.image import imread

from limopa import Exploring, PlanRequest, draw, plan


@sampled("scaffolds", [1, 3], "draws a picture each")
def test_picture_is_drawn(iiwa, tmp_path, scaffolds):
    request = replace(PlanRequest(scaffolds=scaffolds), exploring=Exploring(waypoints=(200, 250)))
    draw(plan(iiwa, request), iiwa, tmp_path / "plan.png")
    image = imread(tmp_path / "plan.png")
    assert image.shape[0] > 1000
    assert image[..., :3].std() > 0.05
