const LOOKS = 50; // poses of a motion, of which the view holds all

// The time slider of a page: the arm moves, its joints show their errors, and the charts follow.
async function play(section) {
  const arm = JSON.parse(document.getElementById("arm-data").textContent);
  await library("three");
  let scene;
  try {
    scene = new ArmScene(section.querySelector(".stage"), arm);
  } catch (error) { // a browser without WebGL shows the picture
    section.classList.add("flat");
    document.body.dataset.arm = "flat";
    return;
  }
  section.classList.add("live");
  const n = scene.joints;
  const floor = arm.floor;
  const motion = arm.motion;
  const find = (what) => section.querySelector(what);
  let shown = find("input[name=colour]:checked")?.value;
  let now = 0;

  const time = motion ? floats(motion.time) : new Float32Array(1);
  const position = motion ? floats(motion.position) : Float32Array.from(arm.pose);
  const row = (values, k) => values.subarray(n * k, n * (k + 1));
  const step = Math.ceil(time.length / LOOKS);
  for (let k = 0; k < time.length; k += step) scene.hold(scene.pose(row(position, k)));
  const ghosts = (motion?.ghosts ?? []).map((ghost) => ({
    name: ghost.name,
    error: floats(ghost.error),
    apart: ghost.position && floats(ghost.position),
    body: ghost.position && scene.addGhost(ghost.colour),
  }));
  const most = Math.max(1e-9, ...(motion?.pushes ?? []).map((p) => Math.hypot(...p.slice(2))));

  function paint() {
    const ghost = ghosts.find((one) => `now ${one.name}` === shown);
    if (ghost) scene.paint(row(ghost.error, now).map(Math.abs), floor, true);
    else scene.paint(arm.errors.find(([name]) => name === shown)?.[1] ?? floor, floor);
  }
  function show(k) {
    now = k;
    const here = row(position, k);
    scene.pose(here);
    const magnified = Number(find("select[name=magnify]")?.value ?? 1);
    ghosts.forEach((ghost) => {
      if (!ghost.body) return;
      ghost.body.root.visible = find(`input[name=ghost][value="${ghost.name}"]`).checked
        && !Number.isNaN(ghost.apart[n * k]); // it was run in a part of the time only
      const apart = row(ghost.apart, k);
      scene.turn(ghost.body, here.map((q, j) => q + magnified * apart[j]));
    });
    if (motion) {
      const t = time[k];
      const push = motion.pushes.find(([start, end]) => start <= t && t <= end);
      scene.push(push?.slice(2), most);
      find("output").textContent = `${t.toFixed(2)} s` +
        (push ? `, pushed by ${Math.hypot(...push.slice(2)).toFixed(1)} N` : "");
      point(t);
    }
    paint();
    scene.render();
  }
  // A line in every chart of this recording over time, where the slider is.
  function point(t) {
    document.querySelectorAll(".chart[data-cursor][data-drawn]").forEach((chart) => {
      const axis = chart._fullLayout?.xaxis;
      if (!axis) return;
      const line = chart.querySelector(":scope > .cursor") ?? chart.appendChild(
        Object.assign(document.createElement("i"), { className: "cursor" }));
      const inside = t >= axis.range[0] && t <= axis.range[1];
      line.hidden = !inside;
      if (inside) line.style.left = `${axis._offset + axis.l2p(t)}px`;
    });
  }
  section.querySelectorAll("input[name=colour]").forEach((button) =>
    button.addEventListener("change", () => { shown = button.value; paint(); scene.render(); }));
  section.querySelectorAll("input[name=ghost], select[name=magnify]").forEach((item) =>
    item.addEventListener("change", () => show(now)));
  const slider = find("input[type=range]");
  if (slider) {
    slider.max = time.length - 1;
    slider.addEventListener("input", () => show(Number(slider.value)));
    let running = 0;
    const button = find("button.play");
    const step = (stamp) => {
      if (!running) return;
      const t = time[0] + ((stamp - running) / 1000);
      const next = time.findIndex((value) => value >= t);
      if (next < 0) { running = 0; button.textContent = "Play"; return; }
      slider.value = next;
      show(next);
      requestAnimationFrame(step);
    };
    button.addEventListener("click", () => {
      running = running ? 0 : performance.now() - 1000 * (time[now] - time[0]);
      button.textContent = running ? "Pause" : "Play";
      requestAnimationFrame(step);
    });
    document.addEventListener("click", (event) => { // a click into a chart takes the slider there
      const chart = event.target.closest?.(".chart[data-cursor][data-drawn]");
      if (!chart) return;
      const axis = chart._fullLayout.xaxis;
      const t = axis.p2l(event.clientX - chart.getBoundingClientRect().left - axis._offset);
      const k = time.findIndex((value) => value >= t);
      if (k >= 0) { slider.value = k; show(k); }
    });
  }
  const recolour = () => {
    section.querySelectorAll(".dot[data-colour]").forEach((dot) => { dot.style.background = themed(dot.dataset.colour); });
    scene.recolour();
    paint();
    scene.render();
  };
  redraw.push(recolour);
  const first = Number(section.dataset.first ?? 0);
  if (slider) slider.value = first;
  show(first);
  recolour();
  document.body.dataset.arm = "drawn";
}
document.querySelectorAll("section.arm").forEach(play);
