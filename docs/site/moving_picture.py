"""Make the moving picture of the README: the arm of a report, turned and played.

limo demo --out out/demo_report
python docs/site/moving_picture.py out/demo_report/report.html docs/arm.webp
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from browser import browser
from PIL import Image

FRAMES = 48
WIDTH, HEIGHT = 880, 460
STEP_MS = 110


def main() -> None:
    """Take the frames and write them as one WebP."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("report", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    with TemporaryDirectory() as folder, browser() as tab:
        tab.look(options.report.resolve().as_uri(), WIDTH, 1400)
        tab.wait("document.body.dataset.arm === 'drawn'")
        frames: list[Image.Image] = []
        for k in range(FRAMES):
            shown = ["given simulation", "improved simulation"][2 * k // FRAMES]
            tab.value(
                f"""(() => {{
                const slider = document.querySelector("#arm input[type=range]");
                const first = Number(document.querySelector("#arm").dataset.first);
                slider.value = Math.max(0, Math.min(slider.max, first - 60 + 5 * {k}));
                slider.dispatchEvent(new Event("input"));
                const radio = document.querySelector('#arm input[value="{shown}"]');
                radio.checked = true;
                radio.dispatchEvent(new Event("change"));
                document.querySelector("#arm .stage").scrollIntoView();
                }})()"""
            )
            path = Path(folder) / f"{k}.png"
            tab.picture(path)
            frames.append(Image.open(path).convert("RGB").crop((0, 0, WIDTH, HEIGHT + 130)))
    frames[0].save(
        options.out, save_all=True, append_images=frames[1:], duration=STEP_MS, loop=0, quality=60,
        method=4,
    )  # fmt: skip
    print(f"wrote {options.out}, {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
