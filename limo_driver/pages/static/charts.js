// Draw every chart that can be seen; those in closed details when they are opened.
const figures = JSON.parse(document.getElementById("figures").textContent);
const touch = matchMedia("(pointer: coarse)").matches;
const config = { displaylogo: false, displayModeBar: false, responsive: true };
const LETTER = 6.6; // [px] of the title of an axis
const LEGEND = 40; // [px] that the height of a chart allows for it
const font = getComputedStyle(document.body).fontFamily;

// Break the title of an axis into two lines where it is longer than its axis; no unit is broken.
function broken(title, room) {
  if (!title?.text || title.text.length * LETTER <= room) return;
  const whole = title.text.replace(/\[[^\]]*\]/g, (unit) => unit.replaceAll(" ", "\u00a0"));
  const middle = whole.length / 2;
  const spaces = [...whole.matchAll(/ /g)].map((found) => found.index);
  if (!spaces.length) return;
  const at = spaces.reduce((a, b) => (Math.abs(b - middle) < Math.abs(a - middle) ? b : a));
  title.text = `${whole.slice(0, at)}<br>${whole.slice(at + 1)}`;
}

async function draw(place) {
  if (place.closest("details:not([open])")) return;
  place.dataset.drawn = "yes";
  place.style.height = place.dataset.height ??= place.style.height;
  await library("plotly");
  const { data, layout } = themed(structuredClone(figures[Number(place.dataset.figure)]));
  layout.font.family = font;
  layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
  layout.width = place.clientWidth;
  const ticks = layout.xaxis?.tickvals; // of a logarithmic axis; on a phone, one a decade has room
  const decades = ticks?.filter((value) => Number.isInteger(Math.log10(value)));
  if (ticks && layout.width < 520 && decades.length > 1) {
    const kept = ticks.map((value) => decades.includes(value));
    layout.xaxis.tickvals = ticks.filter((_, k) => kept[k]);
    layout.xaxis.ticktext = layout.xaxis.ticktext.filter((_, k) => kept[k]);
  }
  const { t = 0, b = 0 } = layout.margin ?? {};
  broken(layout.yaxis?.title, place.clientHeight - t - b);
  if (touch) layout.dragmode = false; // a finger scrolls the page
  await Plotly.react(place, data, layout, config);
  const whole = layout.xaxis?.title?.text; // names of rows may have taken much of the width
  broken(layout.xaxis?.title, place._fullLayout._size.w);
  if (layout.xaxis?.title?.text !== whole) await Plotly.react(place, data, layout, config);
  const more = (place.querySelector(".legend")?.getBBox().height ?? 0) - LEGEND;
  if (more <= 0) return;
  place.style.height = `calc(${place.dataset.height} + ${more}px)`;
  await Plotly.Plots.resize(place); // a legend of more lines would lie over what is drawn
}
const drawAll = (root) => Promise.all(
  [...root.querySelectorAll(".chart:not([data-drawn])")].map(draw));

document.querySelectorAll("details").forEach((item) =>
  item.addEventListener("toggle", () => drawAll(item)));
document.querySelectorAll('a[href^="#"]').forEach((link) =>
  link.addEventListener("click", () => {
    const folded = document.querySelector(link.getAttribute("href"))?.querySelector(":scope > details");
    if (folded) folded.open = true;
  }));
document.querySelectorAll("button.copy").forEach((button) =>
  button.addEventListener("click", async () => {
    const of = document.getElementById(button.dataset.of); // cells of a table, with tabs between them
    await navigator.clipboard.writeText(of.querySelector("table") ? of.innerText : of.textContent);
    button.textContent = "copied";
  }));
const drawn = () => document.querySelectorAll(".chart[data-drawn]").forEach(draw);
redraw.push(drawn);
let width = innerWidth;
addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawn(); } });
drawAll(document).then(() => { document.body.dataset.charts = "drawn"; });
