// Draw every chart that can be seen; those in closed details when they are opened.
const figures = JSON.parse(document.getElementById("figures").textContent);
const touch = matchMedia("(pointer: coarse)").matches;
const config = { displaylogo: false, displayModeBar: false, responsive: true };
const font = getComputedStyle(document.body).fontFamily;

function draw(place) {
  if (place.dataset.drawn || place.closest("details:not([open])")) return;
  place.dataset.drawn = "yes";
  const figure = figures[Number(place.dataset.figure)];
  figure.layout.font.family = font;
  if (touch) figure.layout.dragmode = false; // a finger scrolls the page
  Plotly.newPlot(place, figure.data, figure.layout, config);
}
const drawAll = (root) => root.querySelectorAll(".chart").forEach(draw);

document.querySelectorAll("details").forEach((item) =>
  item.addEventListener("toggle", () => drawAll(item)));
document.querySelectorAll('a[href^="#"]').forEach((link) =>
  link.addEventListener("click", () => {
    const folded = document.querySelector(link.getAttribute("href"))?.querySelector(":scope > details");
    if (folded) folded.open = true;
  }));
drawAll(document);

// Paper has another width than the window: lay out for it, then draw again.
const sized = () => document.querySelectorAll(".chart[data-drawn]").forEach((place) =>
  Plotly.relayout(place, { width: place.clientWidth, height: place.clientHeight }));
addEventListener("beforeprint", () => { document.body.classList.add("paper"); sized(); });
addEventListener("afterprint", () => { document.body.classList.remove("paper"); sized(); });
