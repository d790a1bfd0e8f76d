// The arm in 3-D: links, a ring at each joint, translucent ghosts, arrows, and texts at their places.
const NARROW = 520; // [px] of a stage, in which texts would hide the arm: they stand below it
const DAY = ["#75899d", "#ab7c0a", "#c95d00", "#9e1b16"]; // as in still.py and style.css
const NIGHT = ["#8fa3b5", "#e3b04b", "#f0913a", "#ff6b5e"];
const PATH = 0xd9730d; // in the day and in the dark
const KEY = 0.12, STEEPEST = 1.5; // [rad] that a key turns the view, and its steepest
const PLAIN = 0xd5dbe1; // of what no file gives a colour
const REPLACE = 7681, OTHER = 517, EQUAL = 4; // three's ReplaceStencilOp, NotEqualStencilFunc, EqualDepth
const MARKED = { stencilWrite: true, stencilRef: 1, stencilZPass: REPLACE }; // what no other arm is drawn over
const SHARP = Math.cos(0.6); // [rad] between triangles, from which on their edge is seen as one
const MOST = 100; // noise floors of an error that has the last colour

const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const floats = (text) => new Float32Array(bytesOf(text));

function colourOf(error, floor) {
  const ratio = floor > 0 ? Math.min(Math.max(error / floor, 1), MOST) : 1;
  const scale = isDark() ? NIGHT : DAY;
  const at = (Math.log(ratio) / Math.log(MOST)) * (scale.length - 1);
  const k = Math.min(Math.floor(at), scale.length - 2);
  return new THREE.Color(scale[k]).lerp(new THREE.Color(scale[k + 1]), at - k);
}

// Triangles of which each corner is lit as its surface lies there, without those beyond a sharp edge.
function edged(places, faces) {
  const many = faces.length / 3, flat = new Float32Array(3 * many), around = new Map();
  const at = (v) => new THREE.Vector3().fromArray(places, 3 * v);
  for (let f = 0; f < many; f++) {
    const [a, b, c] = [0, 1, 2].map((k) => at(faces[3 * f + k]));
    b.sub(a).cross(c.sub(a)).toArray(flat, 3 * f); // as long as the triangle is large
    for (let k = 0; k < 3; k++) {
      const v = faces[3 * f + k];
      if (!around.has(v)) around.set(v, []);
      around.get(v).push(f);
    }
  }
  const corners = new Float32Array(9 * many), normals = new Float32Array(9 * many);
  const own = new THREE.Vector3(), other = new THREE.Vector3(), sum = new THREE.Vector3();
  for (let k = 0; k < 3 * many; k++) {
    own.fromArray(flat, 3 * Math.floor(k / 3)).normalize();
    sum.set(0, 0, 0);
    around.get(faces[k]).forEach((f) => {
      other.fromArray(flat, 3 * f);
      if (own.dot(other) >= SHARP * other.length()) sum.add(other);
    });
    sum.normalize().toArray(normals, 3 * k);
    at(faces[k]).toArray(corners, 3 * k);
  }
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(corners, 3));
  shape.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
  return shape;
}

class ArmScene {
  constructor(stage, arm) {
    this.stage = stage;
    this.arm = arm;
    this.joints = arm.own.length; // a joint moves its own link, and those that follow it
    this.links = arm.parent.length;
    this.ghosts = [];
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, stencil: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.domElement.setAttribute("role", "img");
    this.renderer.domElement.setAttribute("aria-label", "The arm in 3-D; drag, or press arrow keys, to turn it");
    this.renderer.domElement.tabIndex = 0;
    this.renderer.domElement.addEventListener("keydown", (event) => this.turnByKey(event));
    stage.prepend(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a939c, 1.8));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, 1, 4);
    this.scene.add(sun);
    this.grid = new THREE.PolarGridHelper(0.6 * arm.length, 8, 4, 48, 0xaab3bb, 0xaab3bb);
    this.grid.rotation.x = Math.PI / 2;
    this.scene.add(this.grid);
    this.body = this.build((colour) => this.solid(colour));
    this.scene.add(this.body.root);
    this.rings = arm.rings.map((radius, j) => this.ring(radius, j));
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01 * arm.length, 20 * arm.length);
    this.camera.up.set(0, 0, 1);
    const seen = this.pose(arm.pose);
    if (arm.motion?.path) this.path(floats(arm.motion.path), seen);
    this.camera.position.set(0.55, 0.75, 0.4);
    this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.frame(seen);
    this.controls.enableZoom = false; // the wheel scrolls the page
    this.controls.update();
    this.controls.addEventListener("change", () => this.render());
    this.labels = this.arm.pins.map((pin) => this.label(pin));
    new ResizeObserver(() => this.render()).observe(stage);
    this.render();
  }

  // See all of a box from where it was looked at; a stage that is higher than wide, from further.
  frame({ low, high }) {
    const middle = low.clone().add(high).multiplyScalar(0.5);
    const { clientWidth: width, clientHeight: height } = this.stage, narrow = width ? Math.max(1, height / width) : 1;
    const away = narrow * Math.max(1.9 * this.arm.length, 1.5 * low.distanceTo(high));
    const from = this.camera.position.clone().sub(this.controls.target).setLength(1.013 * away);
    this.camera.position.copy(middle).add(from);
    this.controls.target.copy(middle);
    this.controls.update();
  }

  // Keep all boxes in sight that an arm was in.
  hold({ low, high }) {
    const before = this.held, shape = this.stage.clientWidth / this.stage.clientHeight;
    this.held = { low: low.min(before?.low ?? low), high: high.max(before?.high ?? high), shape };
    if (before && before.shape === shape && before.low.equals(low) && before.high.equals(high)) return;
    this.frame(this.held);
  }

  // Arrow keys turn the view as a finger does.
  turnByKey(event) {
    const [around, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!around && !up) return;
    event.preventDefault();
    const from = this.camera.position.clone().sub(this.controls.target);
    const flat = Math.hypot(from.x, from.y), away = from.length();
    const azimuth = Math.atan2(from.y, from.x) + KEY * around;
    const height = Math.min(Math.max(Math.atan2(from.z, flat) + KEY * up, -STEEPEST), STEEPEST);
    from.set(Math.cos(height) * Math.cos(azimuth), Math.cos(height) * Math.sin(azimuth), Math.sin(height));
    this.camera.position.copy(this.controls.target).addScaledVector(from, away);
    this.controls.update();
    this.render();
  }

  // What an arm itself is made of: as its file paints it, and marked where it is seen.
  solid(colour) {
    const [r, g, b, opacity] = colour ?? [0, 0, 0, 1];
    const paint = colour ? new THREE.Color().setRGB(r, g, b, "srgb") : PLAIN;
    return [new THREE.MeshStandardMaterial({
      color: paint, roughness: 0.6, metalness: 0.05, side: THREE.DoubleSide, opacity, transparent: opacity < 1,
      ...MARKED,
    })];
  }

  // What a translucent arm is made of: its nearest surface alone, and where the solid arm is not seen.
  // So no two arms cut into each other, however near they are.
  translucent(colour) {
    const outside = {
      transparent: true, stencilWrite: true, stencilRef: 1, stencilFunc: OTHER,
    };
    const seen = new THREE.MeshStandardMaterial({
      color: colour, roughness: 0.6, metalness: 0.05, opacity: 0.45, depthFunc: EQUAL, depthWrite: false,
      side: THREE.DoubleSide, ...outside,
    });
    return [new THREE.MeshStandardMaterial({ colorWrite: false, side: THREE.DoubleSide, ...outside }), seen];
  }

  // One arm of groups that turn, its bodies fixed to them; of each is drawn one material after the other.
  build(materials, order = 0) {
    const { parent, rotation, translation } = this.arm;
    const root = new THREE.Group();
    const frames = parent.map(() => new THREE.Group());
    frames.forEach((frame, j) => {
      const R = rotation[j], p = translation[j];
      frame.userData.home = new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().set(
        ...R[0], 0, ...R[1], 0, ...R[2], 0, 0, 0, 0, 1));
      frame.userData.place = new THREE.Vector3(...p);
      frame.position.copy(frame.userData.place);
      (parent[j] < 0 ? root : frames[parent[j]]).add(frame);
    });
    const add = (joint, colour, make) => materials(colour).forEach((material, k) => {
      const shape = make(material);
      shape.renderOrder = order + k;
      (joint < 0 ? root : frames[joint]).add(shape);
    });
    this.arm.meshes.forEach((mesh) => add(mesh.joint, mesh.colour, (material) => new THREE.Mesh(this.geometry(mesh), material)));
    this.arm.capsules.forEach((c) => add(c[0], null, (material) => this.capsule(c, material)));
    return { root, frames };
  }

  geometry(mesh) {
    if (!mesh.geometry) {
      const packed = new Uint16Array(bytesOf(mesh.vertices));
      const places = Float32Array.from(packed, (v, k) => mesh.low[k % 3] + (v / 65535) * mesh.size);
      const faces = mesh.wide ? new Uint32Array(bytesOf(mesh.faces)) : new Uint16Array(bytesOf(mesh.faces));
      mesh.geometry = edged(places, faces);
    }
    return mesh.geometry;
  }

  capsule([, ax, ay, az, bx, by, bz, radius], material) {
    const a = new THREE.Vector3(ax, ay, az), b = new THREE.Vector3(bx, by, bz);
    const shape = new THREE.Mesh(new THREE.CapsuleGeometry(radius, a.distanceTo(b), 8, 20), material);
    shape.position.copy(a).add(b).multiplyScalar(0.5);
    const along = b.clone().sub(a);
    if (along.length() > 1e-9) shape.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
    return shape;
  }

  ring(radius, j) {
    const material = new THREE.MeshStandardMaterial({ color: DAY[0], roughness: 0.5, ...MARKED });
    const ring = new THREE.Mesh(new THREE.TorusGeometry(radius, 0.012 * this.arm.length, 12, 48), material);
    ring.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...this.arm.axis[this.arm.own[j]]));
    this.body.frames[this.arm.own[j]].add(ring);
    return ring;
  }

  turn(body, position) {
    const { driver, ratio, offset } = this.arm;
    body.frames.forEach((frame, j) => {
      const at = ratio[j] * position[driver[j]] + offset[j];
      const axis = new THREE.Vector3(...this.arm.axis[j]), { home, place } = frame.userData;
      frame.quaternion.copy(home);
      frame.position.copy(place);
      if (this.arm.slides[j]) frame.position.add(axis.multiplyScalar(at).applyQuaternion(home));
      else frame.quaternion.multiply(new THREE.Quaternion().setFromAxisAngle(axis, at));
    });
    body.root.updateMatrixWorld(true);
  }

  // Take a position; returns the box around all that is drawn of the arm, the flange and the base.
  pose(position) {
    this.turn(this.body, position);
    const low = this.place(null), high = low.clone(), base = new THREE.Vector3();
    const include = (least, most) => { low.min(least); high.max(most); };
    include(base, base);
    this.body.root.traverse(({ geometry, matrixWorld }) => {
      if (!geometry) return;
      geometry.boundingBox ?? geometry.computeBoundingBox();
      const { min, max } = geometry.boundingBox.clone().applyMatrix4(matrixWorld);
      include(min, max);
    });
    return { low, high };
  }

  // Where a joint is, or the flange, in axes of the base.
  place(joint) {
    const frame = this.body.frames[joint === null ? this.links - 1 : this.arm.own[joint]];
    return joint === null ? frame.localToWorld(new THREE.Vector3(...this.arm.flange))
      : new THREE.Vector3().setFromMatrixPosition(frame.matrixWorld);
  }

  // A translucent arm; it has another colour in the dark.
  addGhost(colour) {
    const materials = this.translucent(themed(colour));
    const order = 10 * (this.ghosts.length + 1);
    const ghost = { ...this.build(() => materials, order), material: materials.at(-1), colour };
    const first = new THREE.Mesh(new THREE.BufferGeometry(), materials[0]);
    first.frustumCulled = false;
    first.renderOrder = order - 1;
    first.onBeforeRender = (renderer) => renderer.clearDepth(); // arms before it hide none of it
    ghost.root.add(first);
    this.scene.add(ghost.root);
    this.ghosts.push(ghost);
    return ghost;
  }

  // Take the colours of day or night.
  recolour() {
    this.ghosts.forEach((ghost) => ghost.material.color.set(themed(ghost.colour)));
  }

  // Errors of all joints [N m]: colour, and size where they change.
  paint(errors, floor, grow = false) {
    this.rings.forEach((ring, j) => {
      ring.material.color.copy(colourOf(errors[j], floor[j]));
      const ratio = floor[j] > 0 ? Math.abs(errors[j]) / floor[j] : 1;
      const size = grow ? 1 + 0.35 * Math.min(Math.log10(Math.max(ratio, 1)), 2) : 1;
      ring.scale.setScalar(size);
    });
  }

  // A line through points (x, y, z, x, y, z, ...) [m], in axes of the base; a box is made to hold it.
  path(points, box) {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(points, 3));
    shape.computeBoundingBox();
    box.low.min(shape.boundingBox.min);
    box.high.max(shape.boundingBox.max);
    this.scene.add(new THREE.Line(shape, new THREE.LineBasicMaterial({ color: PATH })));
  }

  // An arrow at the flange along a force [N]; none without one.
  push(force, most) {
    if (this.arrow) this.scene.remove(this.arrow);
    this.arrow = null;
    if (!force) return;
    const along = new THREE.Vector3(...force), size = along.length();
    if (!(size > 0)) return;
    const length = (0.15 + 0.35 * size / most) * this.arm.length;
    const from = this.place(null).sub(along.clone().normalize().multiplyScalar(length));
    this.arrow = new THREE.ArrowHelper(along.normalize(), from, length, 0xc2185b, 0.3 * length, 0.16 * length);
    this.scene.add(this.arrow);
  }

  label(pin) {
    const text = document.createElement(pin.link ? "a" : "span");
    if (pin.link) text.href = pin.link;
    text.className = "pin";
    text.textContent = pin.text;
    this.stage.append(text);
    const leader = document.createElementNS("http://www.w3.org/2000/svg", "path");
    this.stage.querySelector("svg.leaders").append(leader);
    return { pin, text, leader };
  }

  placeLabels(width, height) {
    const seen = this.labels.map(({ pin }) => this.place(pin.joint).project(this.camera));
    const order = [...this.labels.keys()].sort((a, b) => seen[b].y - seen[a].y);
    let below = 8;
    order.forEach((k) => {
      const { text, leader } = this.labels[k];
      const x = (seen[k].x + 1) / 2 * width, y = (1 - seen[k].y) / 2 * height;
      const top = Math.max(below, Math.min(y - text.offsetHeight / 2, height - 36 * (order.length - order.indexOf(k))));
      text.style.top = `${top}px`;
      below = top + text.offsetHeight + 6;
      const left = width - text.offsetWidth - 10;
      leader.setAttribute("d", `M${x},${y} L${left},${top + text.offsetHeight / 2}`);
    });
  }

  render() {
    const width = this.stage.clientWidth, height = this.stage.clientHeight;
    if (!width) return;
    this.stage.classList.toggle("crowded", width < NARROW);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    // texts stand at the right: the arm moves to the left where there is room
    const aside = this.labels.length && width >= NARROW ? Math.min(0.16 * width, 0.5 * Math.max(0, width - height)) : 0;
    this.camera.setViewOffset(width, height, aside, 0, width, height);
    this.renderer.render(this.scene, this.camera);
    this.camera.updateMatrixWorld();
    this.placeLabels(width, height);
  }
}
