"""Pages: what commands show in a browser, one HTML file each that needs no network.

`markup` has the pieces of a text and `figures` those of charts; `page` puts them into one file with
the arm in 3-D. `arm` is the geometry that is drawn, `still` its picture on paper, `motion` a motion
that it plays. What is said on a page stands beside what it is said of: `limopa/page.py`,
`estimators/evaluation_page.py` and so on. `static/vendor` holds the two
libraries that draw, plotly.js and three.js, with their licences.
"""

from limo_driver.pages.arm import ArmView, Ghost, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.markup import Charts
from limo_driver.pages.page import Page

__all__ = ["ArmView", "Charts", "Ghost", "Page", "Pin", "PlayedMotion", "PushArrow", "arm_view"]
