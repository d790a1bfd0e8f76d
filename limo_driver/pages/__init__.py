"""Pages: what commands show in a browser, one HTML file each that needs no network.

`markup` has the pieces of a text, `page` puts them into one file with charts and the arm in 3-D,
`arm` is the geometry that is drawn, and `still` its picture on paper. `static/vendor` holds the two
libraries that draw, plotly.js and three.js, with their licences.
"""

from limo_driver.pages.arm import ArmView, Ghost, Pin, PlayedMotion, PushArrow, arm_view
from limo_driver.pages.markup import Charts
from limo_driver.pages.page import Page

__all__ = ["ArmView", "Charts", "Ghost", "Page", "Pin", "PlayedMotion", "PushArrow", "arm_view"]
