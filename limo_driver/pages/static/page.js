// Libraries are packed into the page; unpack one when it is needed first.
const loaded = {};
function unpacked(packed) {
  const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}
function library(name) {
  return (loaded[name] ??= (async () => {
    const script = document.createElement("script");
    script.textContent = await unpacked(document.getElementById(`library-${name}`).textContent).text();
    document.head.append(script);
  })());
}

// What is wider than its place can be reached and scrolled by keyboard.
function reachable() {
  document.querySelectorAll(".scroll, pre").forEach((item) => {
    const scrolls = item.scrollWidth > item.clientWidth + 1;
    item.tabIndex = scrolls ? 0 : -1;
    if (scrolls) {
      item.setAttribute("role", "group");
      item.setAttribute("aria-label", item.matches("pre") ? "Command" : "Table, scrolls sideways");
    } else {
      ["tabindex", "role", "aria-label"].forEach((name) => item.removeAttribute(name));
    }
  });
}
reachable();
addEventListener("resize", reachable);
document.querySelectorAll("details").forEach((item) => item.addEventListener("toggle", reachable));

// Colours of charts are those of paper; in the dark some have to be lighter or darker.
const IN_THE_DARK = {
  "#0b559f": "#6cb2f5", "#2f9e6f": "#4cc38f", "#d9730d": "#f0913a", "#f7f7f5": "#262c33",
  "#c9ced4": "#59636d", "#3d4650": "#c3cad1", "#eceef0": "#323a42",
  "#8fb4d9": "#3d6c96", "#efb27a": "#9c6430", "#b4560a": "#f0913a", "#75899d": "#8fa3b5", "#66707a": "#8b949d",
  "rgba(11,85,159,": "rgba(108,178,245,", "rgba(47,158,111,": "rgba(76,195,143,",
  "rgba(217,115,13,": "rgba(240,145,58,", "#6a3d9a": "#b08ad9", "#2e7d32": "#69b96d",
  "#00838f": "#3cb6c1", "#8c564b": "#c58d80", "#c1272d": "#ef6b6f", "#7a8a00": "#b3c12f",
};
const dark = matchMedia("(prefers-color-scheme: dark)");
const onPaper = () => document.body.classList.contains("paper");
const isDark = () => dark.matches && !onPaper();
function themed(value) {
  if (!isDark()) return value;
  const text = Object.entries(IN_THE_DARK).reduce(
    (said, [day, night]) => said.replaceAll(day, night), JSON.stringify(value));
  return JSON.parse(text);
}

// Paper has another width than the window, and is white.
const redraw = [];
const again = () => redraw.forEach((each) => each());
addEventListener("beforeprint", () => { document.body.classList.add("paper"); again(); });
addEventListener("afterprint", () => { document.body.classList.remove("paper"); again(); });
dark.addEventListener("change", again);
