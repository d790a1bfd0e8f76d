// The live page: values come as events, and are drawn as they come.
const SECONDS = 10;
const place = (id) => document.getElementById(id);
const cell = (tag, text, kind) => Object.assign(document.createElement(tag),
  { textContent: text, className: kind ?? "" });
const shownNumber = (value, digits = 2) => (value === null || value === undefined ? "–" : value.toFixed(digits));

class JointStrip {
  constructor(j) {
    const figure = document.createElement("figure");
    this.caption = figure.appendChild(document.createElement("figcaption"));
    this.canvas = figure.appendChild(document.createElement("canvas"));
    this.canvas.className = "strip";
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Torque of joint ${j + 1} over the last ${SECONDS} s`);
    this.j = j;
    this.rows = [];
    place("joints").append(figure);
  }

  take(t, said) {
    const at = (name) => said[name]?.[this.j] ?? null;
    this.rows.push([t, at("measured"), at("torque"), at("interval")]);
    while (this.rows[0][0] < t - SECONDS) this.rows.shift();
    const sure = at("interval") === null ? "" : ` ± ${shownNumber(at("interval"))}`;
    this.caption.textContent = `Joint ${this.j + 1}: measured ${shownNumber(at("measured"))}, estimated ` +
      `${shownNumber(at("torque"))}${sure}, external ${shownNumber(at("external"))} N m`;
    this.canvas.classList.toggle("pushed", Boolean(said.status?.contact?.[this.j]));
    this.draw(t);
  }

  draw(t) {
    const ratio = devicePixelRatio, width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const values = this.rows.flatMap(([, m, e, s]) => [m, e === null ? null : e - (s ?? 0), e === null ? null : e + (s ?? 0)])
      .filter((v) => v !== null);
    if (!values.length) return;
    const middle = (Math.min(...values) + Math.max(...values)) / 2;
    const half = Math.max(0.05, (Math.max(...values) - Math.min(...values)) / 2) * 1.1;
    const x = (when) => width * (1 - (t - when) / SECONDS), y = (v) => height * (0.5 - (v - middle) / (2 * half));
    const blue = isDark() ? "#6cb2f5" : "#0b559f";
    const line = (k, colour, wide) => {
      pen.beginPath();
      this.rows.forEach((row) => { if (row[k] !== null) pen.lineTo(x(row[0]), y(row[k])); });
      Object.assign(pen, { strokeStyle: colour, lineWidth: wide });
      pen.stroke();
    };
    const known = this.rows.filter((row) => row[2] !== null && row[3] !== null);
    pen.beginPath();
    known.forEach((row) => pen.lineTo(x(row[0]), y(row[2] + row[3])));
    known.toReversed().forEach((row) => pen.lineTo(x(row[0]), y(row[2] - row[3])));
    pen.fillStyle = isDark() ? "rgba(108,178,245,.25)" : "rgba(11,85,159,.18)";
    pen.fill();
    line(1, "#8b949d", 2.4);
    line(2, blue, 1.3);
  }
}

function table(status) {
  const rows = [["state", status.state], ["model", status.model]];
  if (status.rate !== undefined) rows.push(["rate", `${status.rate} Hz, ${status.answered} answered in the last second`]);
  if (status.delay !== undefined) rows.push(["behind the arm", `${(1000 * status.delay).toFixed(0)} ms`]);
  if (status.latency?.count) rows.push(["latency", `p50 ${(1000 * status.latency.p50).toFixed(2)} ms, p99 ${(1000 * status.latency.p99).toFixed(2)} ms`]);
  if (status.arrivals) rows.push(["lost", `${status.arrivals.lost} of ${status.arrivals.received}`]);
  if (status.retraining) rows.push(["drift and retraining", `${status.retraining.stage} ${status.retraining.reason ?? ""}`]);
  place("status").replaceChildren(...rows.map(([name, value]) => {
    const row = document.createElement("tr");
    row.append(cell("td", name), cell("td", String(value ?? "–")));
    return row;
  }));
}

async function follow(section) {
  const arm = JSON.parse(document.getElementById("arm-data").textContent);
  await library("three");
  section.classList.add("live");
  let scene = null;
  try { scene = new ArmScene(section.querySelector(".stage"), arm); } catch { section.hidden = true; }
  const strips = arm.parent.map((_, j) => new JointStrip(j));
  let seen = 0, frames = 0, stamp = null;
  const source = new EventSource("/live");
  let latest = null;
  const draw = () => { // as often as the screen shows it: a slow one skips values
    if (latest) show(latest);
    latest = null;
    requestAnimationFrame(draw);
  };
  requestAnimationFrame(draw);
  source.onmessage = (event) => {
    latest = JSON.parse(event.data);
    document.body.dataset.updates = ++seen;
  };
  const show = (said) => {
    const late = said.age === null || said.age > 1;
    place("said").textContent = said.problem ?? (said.age === null ? "waiting for the arm …"
      : late ? `no joint state for ${said.age.toFixed(0)} s`
        : `model ${said.model ?? "–"}${said.fallback ? ", physics alone" : ""}`);
    section.hidden = !scene || said.drawn === false; // no other robot in its stead
    if (scene && said.position) {
      scene.pose(said.position);
      if (said.external && said.interval) {
        scene.paint(said.external.map((v) => Math.abs(v ?? 0)), said.interval.map((v) => v || 1), true);
      }
      scene.push(said.status?.contact?.some(Boolean) ? said.force : null, Math.max(20, Math.hypot(...(said.force ?? [0]))));
      scene.render();
    }
    if (said.estimate_stamp && said.estimate_stamp !== stamp) {
      stamp = said.estimate_stamp;
      strips.forEach((strip) => strip.take(stamp, said));
    }
    if (said.status) table(said.status);
    place("events").replaceChildren(...(said.events ?? []).toReversed().map((text) => cell("li", text)));
    document.body.dataset.frames = ++frames;
  };
  source.onerror = () => { place("said").textContent = "limo watch has ended"; };
}
document.querySelectorAll("section.arm").forEach(follow);
