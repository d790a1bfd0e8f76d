// Curves of any columns over one time, with a cursor that the arm follows.
const POINTS = 700; // pairs of points of a curve on the screen: more cannot be seen
const HIGH = 96; // [px] of the lowest chart
const LEAST = 1e-4; // of the whole time, that can be zoomed into
const GAP = "rgba(134,143,152,.22)", CUT = "#6a3d9a", LEFT_OUT = "#c1272d";
const WHEEL = 0.0015, STEP = 1.6; // zoom of a wheel's pixel, and of a button
const el = (id) => document.getElementById(id);
const make = (tag, given) => Object.assign(document.createElement(tag), given);
const rounded = (v) => (Number.isFinite(v) ? String(Number(v.toPrecision(5))).replace("-", "\u2212") : "\u2013");

// First index whose time is not before t.
function indexAt(time, t) {
  let low = 0, high = time.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (time[middle] < t) low = middle + 1; else high = middle;
  }
  return low;
}

// Least and most of each stretch from a to b, in the order in which they came.
function thinned({ time, values, offset }, a, b) {
  const x = [], y = [], size = Math.max(1, Math.floor((b - a) / (2 * POINTS)) * 2);
  const push = (k) => { x.push(time[k]); y.push(k < 0 || Number.isNaN(values[k]) ? null : values[k] + offset); };
  for (let start = a; start < b; start += size) {
    let low = -1, high = -1, none = -1;
    for (let k = start; k < Math.min(start + size, b); k++) {
      const v = values[k];
      if (Number.isNaN(v)) none = k;
      else {
        if (low < 0 || v < values[low]) low = k;
        if (high < 0 || v > values[high]) high = k;
      }
    }
    const seen = [low, high, none].filter((k) => k >= 0);
    [...new Set(seen)].sort((p, q) => p - q).forEach(push);
  }
  return { x, y };
}

async function look() {
  const given = JSON.parse(el("curves-data").textContent);
  const bytes = await unpacked(given.packed).arrayBuffer();
  const points = given.points, flags = given.flags.length;
  const time = new Float64Array(bytes, 0, points), flagged = new Float64Array(bytes, 8 * points, flags);
  let at = 8 * (points + flags);
  const curves = given.curves.map((curve) => {
    const own = { ...curve, time, values: new Float32Array(bytes, at, points), odd: new Float32Array(bytes, at + 4 * points, flags) };
    at += 4 * (points + flags);
    return own;
  });
  const whole = [time[0] ?? 0, time[points - 1] ?? 1];
  if (!(whole[1] > whole[0])) whole[1] = whole[0] + 1;
  let range = [...whole], now = whole[0], asked = false;
  const plot = el("plot"), when = el("when");
  if (given.rows > 1) el("finest").textContent = ` Long: the least and the most of each ${given.rows} rows are drawn.`;
  await library("plotly");

  const list = () => curves.filter((curve) => curve.box.checked);
  // Axes one below the other, each for curves of one unit.
  function figure() {
    const drawn = list(), axes = [...new Set(drawn.map((curve) => curve.axis))];
    const [a, b] = [Math.max(0, indexAt(time, range[0]) - 1), Math.min(points, indexAt(time, range[1]) + 2)];
    const { xaxis, yaxis, ...layout } = structuredClone(given.layout);
    const room = plot.parentElement.clientHeight - el("when").parentElement.offsetHeight - 40;
    const height = Math.max(room > 260 ? room : 420, HIGH * axes.length + 60), data = [];
    const bound = axes.map(() => [Infinity, -Infinity]);
    drawn.forEach((curve) => {
      const k = axes.indexOf(curve.axis), y = `y${k ? k + 1 : ""}`, line = thinned(curve, a, b);
      line.y.forEach((v, i) => {
        if (v === null || line.x[i] < range[0] || line.x[i] > range[1]) return;
        bound[k] = [Math.min(bound[k][0], v), Math.max(bound[k][1], v)];
      });
      const name = `${curve.name} (${curve.column})`.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
      const alone = line.x.length < 200 ? "lines+markers" : "lines"; // zoomed in, each row is seen
      data.push({ ...line, yaxis: y, mode: alone, marker: { size: 4 }, line: { color: curve.colour, width: 1.4, dash: curve.dash },
        hovertemplate: `${name}: %{y} at %{x}<extra></extra>` });
      const odd = [...flagged.keys()].filter((i) => flagged[i] >= range[0] && flagged[i] <= range[1]);
      if (odd.length) data.push({ x: odd.map((i) => flagged[i]), y: odd.map((i) => (Number.isNaN(curve.odd[i]) ? null : curve.odd[i] + curve.offset)),
        yaxis: y, mode: "markers", marker: { color: LEFT_OUT, size: 3 },
        text: odd.map((i) => given.flags[i]), hovertemplate: `${name}: %{y}, left out: %{text}<extra></extra>` });
    });
    axes.forEach((axis, k) => {
      const part = 1 / axes.length, [low, high] = bound[k], pad = 0.06 * (high - low) || 0.5 * (Math.abs(high) || 1);
      layout[`yaxis${k ? k + 1 : ""}`] = { ...structuredClone(yaxis), title: { text: axis.replaceAll("<", "&lt;"), standoff: 6, font: { size: 11 } },
        domain: [1 - part * (k + 1) + (k < axes.length - 1 ? 0.1 * part : 0), 1 - part * k], fixedrange: true, nticks: 5,
        range: low <= high ? [low - pad, high + pad] : [-1, 1], automargin: false };
    });
    const wide = (gap) => gap[1] > range[0] && gap[0] < range[1];
    const box = ([x0, x1]) => ({ type: "rect", x0, x1, y0: 0, y1: 1, yref: "paper", line: { width: 0 }, fillcolor: GAP, layer: "below" });
    const cut = ([x0, x1]) => ({ type: "line", x0: (x0 + x1) / 2, x1: (x0 + x1) / 2, y0: 0, y1: 1, yref: "paper", line: { color: CUT, width: 1.5, dash: "dash" } });
    const rug = [...new Set([...flagged].filter((t) => t >= range[0] && t <= range[1])
      .map((t) => Math.round(400 * (t - range[0]) / (range[1] - range[0]))))]
      .map((k) => range[0] + k * (range[1] - range[0]) / 400)
      .map((x) => ({ type: "line", x0: x, x1: x, y0: 0, y1: 0.025, yref: "paper", line: { color: LEFT_OUT, width: 1.5 } }));
    layout.shapes = [...given.gaps.filter(wide).map(box), ...given.cuts.filter(wide).flatMap((c) => [box(c), cut(c)]), ...rug];
    layout.xaxis = { ...xaxis, range: [...range], anchor: axes.length > 1 ? `y${axes.length}` : "y" };
    Object.assign(layout, { height, width: plot.clientWidth, showlegend: false, dragmode: touch ? false : "zoom" });
    Object.assign(layout.font, { family: font });
    Object.assign(layout.margin, { l: 62 });
    layout.paper_bgcolor = layout.plot_bgcolor = "rgba(0,0,0,0)";
    return [data, layout];
  }
  async function drawNow() {
    asked = false;
    await Plotly.react(plot, ...themed(figure()), { ...config, responsive: false, doubleClick: false });
    plot.dataset.drawn = "yes";
    [when.min, when.max] = range;
    show(now);
    document.body.dataset.curves = "drawn";
  }
  const draw = () => { if (!asked) { asked = true; requestAnimationFrame(drawNow); } };

  function zoom(from, to) {
    const least = LEAST * (whole[1] - whole[0]), span = Math.min(Math.max(to - from, least), whole[1] - whole[0]);
    const start = Math.min(Math.max((from + to - span) / 2, whole[0]), whole[1] - span);
    range = [start, start + span];
    draw();
  }
  const about = (t, factor) => zoom(t - (t - range[0]) * factor, t + (range[1] - t) * factor);
  const atPixel = (event) => {
    const axis = plot._fullLayout.xaxis;
    return axis.p2l(event.clientX - plot.getBoundingClientRect().left - axis._offset);
  };

  // The cursor, the values beside the names, and the pose of the arm.
  let scene = null;
  function show(t) {
    now = Math.min(Math.max(t, whole[0]), whole[1]);
    const k = Math.max(0, Math.min(indexAt(time, now + 1e-9) - 1, points - 1));
    when.value = now;
    el("at").textContent = given.layout.xaxis.title.text.endsWith("[s]") ? `${now.toFixed(3)} s` : `row ${Math.round(now)}`;
    curves.forEach((curve) => { curve.value.textContent = rounded(curve.values[k] + curve.offset); });
    const axis = plot._fullLayout?.xaxis;
    if (axis) {
      const line = plot.querySelector(":scope > .cursor") ?? plot.appendChild(make("i", { className: "cursor" }));
      line.hidden = now < range[0] || now > range[1];
      const { t, h } = plot._fullLayout._size;
      Object.assign(line.style, { left: `${axis._offset + axis.l2p(now)}px`, top: `${t}px`, height: `${h}px` });
    }
    if (!scene) return;
    const q = given.pose.map((c) => curves[c].values[k] + curves[c].offset);
    if (q.every(Number.isFinite)) { scene.pose(q); scene.render(); }
  }

  // The columns, by their axes.
  [...new Set(curves.map((curve) => curve.axis))].forEach((axis) => {
    const body = make("tbody"), head = make("tr");
    const cell = head.appendChild(make("th", { colSpan: 3, scope: "rowgroup" })), own = curves.filter((curve) => curve.axis === axis);
    const all = make("input", { type: "checkbox", checked: own.every((curve) => curve.drawn) });
    all.addEventListener("change", () => { own.forEach((curve) => { if (!curve.row.hidden) curve.box.checked = all.checked; }); draw(); });
    cell.appendChild(make("label")).append(all, ` ${axis}`);
    body.append(head);
    own.forEach((curve) => {
      const row = body.appendChild(make("tr", { title: `${curve.column}: ${curve.read}` })), label = make("label");
      const swatch = make("i", { className: `swatch ${curve.dash}` });
      swatch.dataset.colour = curve.colour;
      curve.box = make("input", { type: "checkbox", checked: curve.drawn });
      curve.box.addEventListener("change", draw);
      label.append(curve.box, swatch, ` ${curve.name}`);
      row.appendChild(make("td")).append(label);
      row.append(make("td", { className: "small", textContent: curve.read }));
      curve.value = row.appendChild(make("td", { className: "n" }));
      curve.row = row;
    });
    (el("columns").querySelector("table") ?? el("columns").appendChild(make("table"))).append(body);
  });
  el("columns").tabIndex = 0;
  el("columns").setAttribute("role", "group");
  el("columns").setAttribute("aria-label", "Columns, their values at the cursor");
  const recolour = () => document.querySelectorAll(".swatch").forEach((item) => { item.style.borderColor = themed(item.dataset.colour); });
  const words = () => el("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  el("filter").addEventListener("input", () => {
    curves.forEach((curve) => {
      const text = `${curve.name} ${curve.column} ${curve.axis} ${curve.read}`.toLowerCase();
      curve.row.hidden = !words().every((word) => text.includes(word));
    });
    document.querySelectorAll("#columns tbody").forEach((body) => { body.hidden = ![...body.rows].slice(1).some((row) => !row.hidden); });
  });
  el("filter").addEventListener("keydown", (event) => { if (event.key === "Enter") el("only").click(); });
  el("only").addEventListener("click", () => { curves.forEach((curve) => { curve.box.checked = !curve.row.hidden; }); draw(); });
  el("none").addEventListener("click", () => { curves.forEach((curve) => { curve.box.checked = false; }); draw(); });

  when.addEventListener("input", () => show(Number(when.value)));
  el("in").addEventListener("click", () => about(now, 1 / STEP));
  el("out").addEventListener("click", () => about(now, STEP));
  el("whole").addEventListener("click", () => zoom(...whole));
  plot.addEventListener("wheel", (event) => {
    if (!plot._fullLayout) return;
    event.preventDefault();
    if (event.shiftKey) {
      const by = (event.deltaX || event.deltaY) * 0.001 * (range[1] - range[0]);
      zoom(range[0] + by, range[1] + by);
    } else about(atPixel(event), Math.exp(WHEEL * event.deltaY));
  }, { passive: false });
  plot.addEventListener("dblclick", () => zoom(...whole));
  let pressed = 0;
  plot.addEventListener("pointerdown", (event) => { pressed = event.clientX; }, true);
  plot.addEventListener("click", (event) => { if (Math.abs(event.clientX - pressed) < 4) show(atPixel(event)); }, true);
  let running = 0;
  const play = el("play"), stop = () => { running = 0; play.textContent = "Play"; };
  const step = (stamp) => {
    if (!running) return;
    const next = now + Number(el("speed").value) * (stamp - running) / 1000;
    running = stamp;
    if (next >= whole[1]) stop();
    if (next > range[1] && range[1] < whole[1]) zoom(next, next + range[1] - range[0]);
    show(next);
    requestAnimationFrame(step);
  };
  play.addEventListener("click", () => {
    if (running) { stop(); return; }
    if (now >= whole[1]) now = whole[0];
    running = performance.now();
    play.textContent = "Pause";
    requestAnimationFrame(step);
  });
  redraw.push(recolour, draw);
  addEventListener("resize", draw);
  recolour();
  await drawNow();
  plot.on("plotly_relayout", (changed) => {
    const from = changed["xaxis.range[0]"], to = changed["xaxis.range[1]"];
    if (from !== undefined) zoom(Number(from), Number(to));
  });

  const arm = JSON.parse(el("arm-data").textContent), section = el("arm");
  if (!arm || !section) return;
  try {
    await library("three");
    section.classList.add("live");
    scene = new ArmScene(section.querySelector(".stage"), arm);
    const every = Math.max(1, Math.floor(points / 60)); // all poses stay in sight
    for (let k = 0; k < points; k += every) {
      const q = given.pose.map((c) => curves[c].values[k] + curves[c].offset);
      if (q.every(Number.isFinite)) scene.hold(scene.pose(q));
    }
    show(now);
    document.body.dataset.arm = "drawn";
  } catch (error) { // a browser without WebGL shows the picture
    section.classList.remove("live");
    document.body.dataset.arm = "flat";
  }
}
look();
