// The live page: values come as events, are kept, and are drawn as they come or where one looks.
const KEPT = 600; // [s] of values
const LATE = 2; // [s] by which a value may come after one that follows it
const SILENT = 0.5; // [s] without a value, after which there is a gap
const place = (id) => document.getElementById(id);
const cell = (tag, text, kind) => Object.assign(document.createElement(tag),
  { textContent: text, className: kind ?? "" });
const shownNumber = (value, digits = 2) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));
const clock = (t) => new Date(1000 * t).toLocaleTimeString([], { hour12: false });
const paint = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);

// What came, for as long as it is kept; `end` is the time at the right of all curves.
class History {
  constructor() {
    Object.assign(this, { rows: [], marks: new Map(), came: 0, held: null });
  }

  take(said) {
    const t = said.estimate_stamp, last = this.rows.at(-1)?.t;
    if (t === undefined || (t <= last && t > last - LATE)) return;
    if (t < last) this.rows = []; // the robot's clock began anew
    this.rows.push({ ...said, t });
    while (this.rows[0].t < t - KEPT) this.rows.shift();
    this.came = performance.now();
  }

  mark(events) {
    events.forEach(({ kind, t, text, joint, began, ended }) => {
      if (kind === "swap") this.marks.set(`${kind} ${t}`, { t, text });
      if (began && kind.startsWith("contact")) this.marks.set(`contact ${joint} ${began}`, { t: began, joint, ended });
    });
  }

  get newest() {
    const silent = (performance.now() - this.came) / 1000;
    return (this.rows.at(-1)?.t ?? 0) + (silent > SILENT ? silent : 0);
  }

  get end() { return this.held ?? this.newest; }

  // The last row that was known at a time.
  at(t) {
    let low = 0, high = this.rows.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.rows[middle].t <= t) low = middle + 1; else high = middle;
    }
    return this.rows[low - 1];
  }
}

class JointStrip {
  constructor(name, j, kept) {
    const figure = document.createElement("figure");
    this.caption = figure.appendChild(document.createElement("figcaption"));
    this.canvas = figure.appendChild(cell("canvas", "", "strip"));
    this.canvas.setAttribute("role", "img");
    const plain = name.toLowerCase().replace(/[^a-z0-9]/g, "").endsWith(`joint${j + 1}`);
    Object.assign(this, { name, j, kept, label: plain ? `joint ${j + 1}` : `joint ${j + 1} (${name})` });
    this.canvas.setAttribute("aria-label", `Torque of ${this.label} over time`);
    place("joints").append(figure);
  }

  value(row, name) { return row?.[name]?.[this.j] ?? null; }

  draw(span) {
    const { end, rows, marks } = this.kept, start = end - span, now = this.kept.at(end);
    const external = this.value(now, "external"), sure = this.value(now, "interval");
    const lost = this.value(now, "torque") === null || end - now.t > SILENT; // two digits of the interval, of any arm's scale
    const digits = sure === null ? 2 : Math.min(4, Math.max(1, 1 - Math.floor(Math.log10(Math.max(sure, 1e-4)))));
    const unlike = now.outside?.[this.j] && !now.fallback; // a phone has no room for the words, and shows it in grey
    this.caption.replaceChildren(cell("b", this.label), cell("i", unlike ? "external, unlike what was learned" : "external"),
      cell("span", lost ? "no value" : `${shownNumber(external, digits)}${sure === null ? "" : ` ± ${shownNumber(sure, digits)}`} N m`,
        unlike ? "unlike" : ""));
    const pushed = [...marks.values()].some((m) => m.joint === this.j + 1 && m.t <= end && (m.ended ?? end) >= end);
    this.canvas.classList.toggle("pushed", pushed);
    const ratio = devicePixelRatio, width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const first = Math.max(0, rows.indexOf(this.kept.at(start)));
    const seen = rows.slice(first, rows.indexOf(now) + 1).map((row) =>
      ["t", "measured", "torque", "interval"].map((name) => (name === "t" ? row.t : this.value(row, name))));
    const values = seen.flatMap(([, m, e, s]) => [m, e === null ? null : e - (s ?? 0), e === null ? null : e + (s ?? 0)])
      .filter((v) => v !== null);
    const low = values.length ? Math.min(...values) : -1, high = values.length ? Math.max(...values) : 1;
    const half = Math.max(0.05, (high - low) / 2) * 1.1, left = 38, bottom = height - 14;
    const x = (t) => left + (width - left) * ((t - start) / span);
    const y = (v) => bottom * (0.5 - (v - (low + high) / 2) / (2 * half));
    this.axes(pen, { low: (low + high) / 2 - half, high: (low + high) / 2 + half, x, y, left, bottom, width, end, span });
    pen.save();
    pen.beginPath();
    pen.rect(left, 0, width - left, bottom);
    pen.clip();
    const box = (from, to, colour) => Object.assign(pen, { fillStyle: colour }).fillRect(Math.floor(x(from)), 0, Math.ceil(x(to)) - Math.floor(x(from)), bottom);
    const ends = [...seen.slice(1).map(([t]) => t), end];
    seen.forEach(([t, , e], k) => { if (e === null || ends[k] - t > SILENT) box(t, ends[k], paint("gap")); });
    marks.forEach(({ t, joint, ended }) => { if (joint === this.j + 1) box(t, ended ?? end, paint("pushed")); });
    this.curves(pen, seen, x, y);
    Object.assign(pen, { strokeStyle: paint("swap"), fillStyle: paint("swap"), lineWidth: 1.5 });
    marks.forEach(({ t, joint }) => {
      if (joint) return;
      pen.setLineDash([4, 3]);
      pen.beginPath();
      pen.moveTo(x(t), 0);
      pen.lineTo(x(t), bottom);
      pen.stroke();
      pen.fillText("swap", x(t) + 3, 9);
    });
    pen.restore();
  }

  // Torques [N m] at the left, and seconds before now below.
  axes(pen, { low, high, x, y, left, bottom, width, end, span }) {
    const rough = (high - low) / Math.max(2, Math.min(5, bottom / 16)), tens = 10 ** Math.floor(Math.log10(rough));
    const step = tens * [1, 2, 5, 10].find((k) => k * tens >= rough), digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    Object.assign(pen, { font: `10px ${getComputedStyle(document.body).fontFamily}`, fillStyle: paint("soft"),
      strokeStyle: paint("line"), lineWidth: 1, textAlign: "right" });
    for (let v = Math.ceil(low / step) * step; v <= high; v += step) {
      if (y(v) < 5 || y(v) > bottom - 3) continue;
      pen.fillText(Math.abs(v) < step / 2 ? "0" : shownNumber(v, digits), left - 4, y(v) + 3);
      pen.strokeRect(left, Math.round(y(v)) + 0.5, width - left, 0);
    }
    Object.assign(pen, { textAlign: "left" }).fillText("N m", 2, bottom + 11);
    for (let k = 0; k <= 4; ++k) {
      const back = span * (1 - k / 4), text = back ? `−${back} s` : this.kept.held ? clock(end) : "now";
      pen.textAlign = k === 4 ? "right" : k ? "center" : "left";
      if (width > 260 || k % 2 === 0) pen.fillText(text, x(end - back), bottom + 11);
    }
    pen.textAlign = "left";
  }

  // Each stretch of values by itself: nothing is drawn through a gap.
  curves(pen, seen, x, y) {
    const stretch = [];
    const flush = () => {
      const known = stretch.filter(([, , , s]) => s !== null);
      pen.beginPath();
      known.forEach(([t, , e, s]) => pen.lineTo(x(t), y(e + s)));
      known.toReversed().forEach(([t, , e, s]) => pen.lineTo(x(t), y(e - s)));
      pen.fillStyle = paint("band");
      pen.fill();
      [[1, paint("measured"), 2.2], [2, paint("after"), 1.2]].forEach(([k, strokeStyle, lineWidth]) => {
        pen.beginPath();
        stretch.forEach((row) => { if (row[k] !== null) pen.lineTo(x(row[0]), y(row[k])); });
        Object.assign(pen, { strokeStyle, lineWidth }).stroke();
      });
      stretch.length = 0;
    };
    seen.forEach((row) => {
      if (row[2] === null || (stretch.length && row[0] - stretch.at(-1)[0] > SILENT)) flush();
      if (row[2] !== null) stretch.push(row);
    });
    flush();
  }
}

function table(status) {
  const rows = [["state", status.state], ["model", status.model]];
  if (status.rate !== undefined) rows.push(["rate", `${status.rate} Hz, ${status.answered} answered in the last second`]);
  if (status.delay !== undefined) rows.push(["behind the arm", `${(1000 * status.delay).toFixed(0)} ms`]);
  if (status.latency?.count) rows.push(["latency", `p50 ${(1000 * status.latency.p50).toFixed(2)} ms, p99 ${(1000 * status.latency.p99).toFixed(2)} ms`]);
  if (status.arrivals) rows.push(["lost", lostOf(status.arrivals)]);
  if (status.retraining) rows.push(["drift and retraining", `${status.retraining.stage} ${status.retraining.reason ?? ""}`]);
  place("status").replaceChildren(...rows.map(([name, value]) => {
    const row = document.createElement("tr");
    row.append(cell("td", name), cell("td", String(value ?? "–")));
    return row;
  }));
}

function lostOf({ lost, received }) {
  const all = lost + received;
  return `${lost} of ${all}${lost ? ` (${(100 * lost / all).toPrecision(2)} %)` : ""}`;
}

const line = ({ t, kind, text, times }) =>
  cell("li", `${clock(t)} ${text}${times > 1 ? ` (${times} times)` : ""}`, kind.startsWith("contact") || kind === "swap" ? "noted" : "");

function headline(said) {
  if (said.problem) return said.problem;
  if (said.age === null) return "waiting for the arm …";
  if (said.age > 1) return `no joint state for ${said.age.toFixed(0)} s`;
  const arrivals = said.status?.arrivals;
  return `model ${said.model ?? "–"}${said.fallback ? ", physics alone" : ""}${arrivals ? `, lost ${lostOf(arrivals)}` : ""}`;
}

async function follow(section) {
  const arm = JSON.parse(document.getElementById("arm-data").textContent);
  await library("three");
  section.classList.add("live");
  let scene = null;
  try { scene = new ArmScene(section.querySelector(".stage"), arm); } catch { section.hidden = true; }
  const kept = new History(), pause = place("pause"), when = place("when"), span = place("span");
  let seen = 0, frames = 0, latest = null, drawn = -Infinity, strips = [];
  const hold = (t) => {
    kept.held = t;
    pause.textContent = t === null ? "Pause" : "Live";
    look();
  };
  const look = () => { // draw the time that is looked at
    const end = kept.end, row = kept.at(end);
    [when.min, when.max] = [Math.min(kept.rows[0]?.t ?? 0, end), kept.newest];
    when.value = end;
    place("at").textContent = kept.held === null ? "live" : clock(end);
    strips.forEach((strip) => strip.draw(Number(span.value)));
    const said = kept.held === null ? latest ?? row : row;
    if (!scene || !said?.position) return;
    scene.hold(scene.pose(said.position));
    const { felt, age } = said;
    if (felt && said.interval) {
      scene.paint(felt.map((v) => (age > 1 ? 0 : Math.abs(v ?? 0))), said.interval.map((v) => v || 1), true);
    }
    const pushed = [...kept.marks.values()].filter((m) => m.joint && m.t <= end && (m.ended ?? end) >= end);
    pushed.forEach((m) => scene.rings[m.joint - 1]?.material.color.set(paint("bad").trim()));
    scene.push(pushed.length ? said.force : null, Math.max(20, Math.hypot(...(said.force ?? [0]))));
    scene.render();
  };
  pause.addEventListener("click", () => hold(kept.held === null ? kept.newest : null));
  when.addEventListener("input", () => hold(Number(when.value)));
  span.addEventListener("change", look);
  new ResizeObserver(look).observe(place("joints"));
  redraw.push(look);
  const draw = (stamp) => { // as often as the screen shows it: a slow one skips values
    if (kept.held === null && stamp - drawn > 40) { drawn = stamp; look(); }
    requestAnimationFrame(draw);
  };
  const source = new EventSource("/live");
  source.onmessage = (event) => {
    latest = JSON.parse(event.data);
    document.body.dataset.updates = ++seen;
    if (latest.names && latest.names.join() !== strips.map((strip) => strip.name).join()) {
      place("joints").replaceChildren(); // of the stream: the robot that is drawn may be another
      strips = latest.names.map((name, j) => new JointStrip(name, j, kept));
    }
    kept.take(latest);
    kept.mark(latest.events ?? []);
    place("said").textContent = headline(latest);
    section.hidden = !scene || latest.drawn === false; // no other robot in its stead
    table(latest.status ?? { state: "no service answers" });
    place("events").replaceChildren(...(latest.events ?? []).toReversed().map(line));
    document.body.dataset.frames = ++frames;
  };
  source.onerror = () => { place("said").textContent = "limo watch has ended"; };
  requestAnimationFrame(draw);
}
document.querySelectorAll("section.arm").forEach(follow);
