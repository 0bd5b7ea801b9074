// The page: settings changed by mouse, keys and controls, and when to draw.

import { Frame, clamp, modeName, depthOrder, patchSize, visiblePatchSize } from "lfrender/geometry";
import { Renderer } from "lfrender/renderer";
import { bytes, loadScene } from "lfrender/scene";

const CLICK = 4; // px a click may move
const SLOW = 15; // ms that a picture may take while something moves, for 60 a second; beyond, it is drawn coarser
const COARSEST = 6;
const $ = id => document.getElementById(id);

class Viewer {
  constructor(scene, renderer, canvas) {
    Object.assign(this, { scene, renderer, canvas });
    this.frame = new Frame(scene);
    this.settings = { mode: "focus", plane: scene.plane, aperture: 1, q: [0, 0], overlay: 0, background: [0, 0, 0] };
    this.coarse = 1;
    this.moving = false;
    this.fitted = true;
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.controls();
    this.pointer();
    canvas.addEventListener("keydown", event => this.key(event));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.set({}));
    canvas.addEventListener("webglcontextlost", () => showStatus("The graphics card was reset; reload the page."));
    this.resize();
  }

  // --- drawing

  set(change) {
    Object.assign(this.settings, change);
    const { scene, settings } = this;
    settings.plane = patchSize(clamp(depthOrder(settings.plane, scene.pitch), ...scene.planes), scene.pitch);
    const length = Math.hypot(...settings.q);
    if (length > scene.radius) settings.q = settings.q.map(n => (n * scene.radius) / length);
    this.showSettings();
    if (settings.mode === "tiles") this.loadPlain();
    this.request();
  }

  // The flat without prefilter, loaded when first needed.
  loadPlain() {
    if (!this.ready) return;
    this.plain ??= this.renderer.loadPlain((done, all) => showStatus(done < all ? `Loading the flat, ${done} of ${all}` : ""))
      .then(() => this.request()).catch(error => showStatus(error.message));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.width = Math.round(width * devicePixelRatio);
    this.height = Math.round(height * devicePixelRatio);
    if (this.fitted) this.frame.fit(this.width, this.height);
    this.set({});
  }

  request() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = undefined;
      this.draw();
    });
  }

  draw() {
    if (!this.ready || (this.settings.mode === "tiles" && !this.renderer.textures.plainTiles)) return;
    const { canvas, frame, renderer } = this, factor = this.moving ? this.coarse : 1;
    const width = Math.max(1, Math.round(this.width / factor)), height = Math.max(1, Math.round(this.height / factor));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const spacing = (frame.spacing * this.width) / width, start = performance.now();
    const first = [frame.middle[0] - ((width - 1) / 2) * spacing, frame.middle[1] - ((height - 1) / 2) * spacing];
    const stage = getComputedStyle(canvas.parentElement).backgroundColor.match(/[\d.]+/g).slice(0, 3);
    this.settings.background = stage.map(n => n / 255);
    // With coarser pixels, one sample each: more would take the time that was saved.
    renderer.draw(factor > 1 ? { ...this.settings, most: 1 } : this.settings, width, height, first, spacing);
    // Measured at rest too, so that on a slow card the first pictures of a movement are coarse already.
    this.time(start, factor);
  }

  // Drawing continues after the call has returned, until the graphics card signals the fence.
  time(start, factor) {
    const { gl } = this.renderer, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    // Polled by timeouts: animation frames are too rare to measure the time.
    const look = () => {
      if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return void setTimeout(look);
      gl.deleteSync(fence);
      const taken = performance.now() - start;
      // The time is proportional to the number of pixels.
      if (taken > SLOW) this.coarse = Math.min(COARSEST, factor * Math.sqrt(taken / SLOW));
      else if (taken < SLOW / 3) this.coarse = Math.max(1, factor / 1.25);
    };
    setTimeout(look);
  }

  // Draw coarser while something moves, and in full when it rests.
  move(change) {
    this.moving = true;
    clearTimeout(this.rest);
    this.rest = setTimeout(() => {
      this.moving = false;
      this.request();
    }, 160);
    this.set(change);
  }

  // --- focus, zoom

  focus(u, v) {
    const { scene, settings, frame } = this, [x, y] = frame.at(u, v, this.width, this.height);
    if (x < -0.5 || y < -0.5 || x > scene.size[0] - 0.5 || y > scene.size[1] - 0.5) return;
    const still = scene.pitch / settings.plane, moved = settings.q.map(n => n * still);
    const s = visiblePatchSize(scene, x, y, settings.q, still);
    const { first, spacing, shape, resolved } = scene.surface;
    const column = clamp(Math.round((x - moved[0] - first[0]) / spacing), 0, shape[1] - 1);
    const row = clamp(Math.round((y - moved[1] - first[1]) / spacing), 0, shape[0] - 1);
    const own = resolved[row * shape[1] + column];
    this.set({ plane: s, mode: settings.mode === "sharp" ? "focus" : settings.mode });
    showStatus(own ? "" : "No depth was found here; focused at the depth of its neighbours.");
  }

  zoom(factor, u = (this.width - 1) / 2, v = (this.height - 1) / 2) {
    this.fitted = false;
    this.frame.zoom(factor, u, v, this.width, this.height, this.scene.pitch / (8 * this.scene.scale));
    this.move({});
  }

  full() {
    this.zoom((this.frame.spacing * this.scene.scale) / this.scene.pitch);
  }

  fit() {
    this.fitted = true;
    this.resize();
  }

  look(dx, dy) {
    this.move({ q: [this.settings.q[0] + dx, this.settings.q[1] + dy] });
  }

  near(step) {
    const { pitch, planes } = this.scene;
    this.move({ plane: patchSize(clamp(depthOrder(this.settings.plane, pitch) + step * (planes[1] - planes[0]), ...planes), pitch) });
  }

  // --- mouse and fingers

  pointer() {
    const { canvas } = this, down = new Map();
    let start, travelled = 0;
    const place = event => [event.offsetX * devicePixelRatio, event.offsetY * devicePixelRatio];
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      down.set(event.pointerId, place(event));
      start = { q: this.settings.q, pan: event.shiftKey || event.button !== 0, several: down.size > 1 };
      if (down.size === 1) travelled = 0;
    });
    canvas.addEventListener("pointermove", event => {
      const before = down.get(event.pointerId);
      if (!before) return;
      const now = place(event), [du, dv] = now.map((n, k) => n - before[k]);
      down.set(event.pointerId, now);
      travelled += Math.hypot(du, dv) / devicePixelRatio;
      if (travelled <= CLICK) return;
      canvas.classList.add("moving");
      if (down.size > 1) this.pinch([...down.values()], before, now);
      else if (start.pan) this.pan(du, dv);
      // A third of the picture's width moves across the whole aperture; near objects follow the hand.
      else this.look(-(du / this.width) * 6 * this.scene.radius, -(dv / this.width) * 6 * this.scene.radius);
    });
    const end = event => {
      if (!down.delete(event.pointerId)) return;
      canvas.classList.remove("moving");
      if (event.type === "pointerup" && travelled <= CLICK && !start.pan && !start.several) this.focus(...place(event));
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("contextmenu", event => event.preventDefault());
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
      this.zoom(Math.exp(-clamp(event.deltaY * lines, -300, 300) / 500), ...place(event));
    }, { passive: false });
  }

  pinch(fingers, before, now) {
    const other = fingers.find(finger => finger !== now);
    const [was, is] = [before, now].map(n => Math.hypot(n[0] - other[0], n[1] - other[1]));
    this.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
    if (was > 1) this.zoom(is / was, (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
  }

  pan(du, dv) {
    this.fitted = false;
    this.frame.pan(du, dv);
    this.move({});
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const toggle = mode => this.set({ mode: this.settings.mode === mode ? "focus" : mode });
    const actions = {
      "+": () => this.zoom(1.25), "=": () => this.zoom(1.25), "-": () => this.zoom(0.8), "0": () => this.fit(), "1": () => this.full(),
      PageUp: () => this.near(0.02), PageDown: () => this.near(-0.02), Enter: () => this.focus((this.width - 1) / 2, (this.height - 1) / 2),
      ",": () => this.aperture(-0.05), ".": () => this.aperture(0.05), a: () => toggle("sharp"), t: () => toggle("tiles"),
      m: () => this.set({ overlay: this.settings.overlay ? 0 : 0.6 }), c: () => this.set({ q: [0, 0] }),
    };
    const action = arrow
      ? () => (event.shiftKey ? this.pan(-60 * arrow[0], -60 * arrow[1]) : this.look(...arrow.map(n => n * 0.08 * this.scene.radius)))
      : actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  aperture(step) {
    this.move({ aperture: clamp(this.settings.aperture + step, 0.05, 1) });
  }

  // --- controls beside the picture

  controls() {
    const { scene } = this, { pitch } = scene;
    [$("plane").min, $("plane").max] = scene.planes;
    $("plane").addEventListener("input", event => this.move({ plane: patchSize(Number(event.target.value), pitch) }));
    $("aperture").addEventListener("input", event => this.move({ aperture: Number(event.target.value) }));
    for (const choice of document.getElementsByName("mode")) choice.addEventListener("change", () => this.set({ mode: choice.value }));
    $("overlay").addEventListener("change", event => this.set({ overlay: event.target.checked ? 0.6 : 0 }));
    $("centre").addEventListener("click", () => this.set({ q: [0, 0] }));
    $("in").addEventListener("click", () => this.zoom(1.25));
    $("out").addEventListener("click", () => this.zoom(0.8));
    $("full").addEventListener("click", () => this.full());
    $("fit").addEventListener("click", () => this.fit());
    $("save").addEventListener("click", () => this.save());
    const [low, high] = scene.overlay.limits, ramp = bytes(scene.overlay.ramp), stops = [];
    for (let n = 0; n < 256; n += 15) stops.push(`rgb(${ramp.slice(3 * n, 3 * n + 3).join(" ")})`);
    $("ramp").style.background = `linear-gradient(to right, ${stops})`;
    $("low").textContent = `M = ${low.toFixed(1)}`;
    $("high").textContent = high.toFixed(1);
    $("about").textContent = `${scene.size.join(" × ")} px, pitch ${pitch.toFixed(2)} px`;
  }

  showSettings() {
    const { scene, settings, frame } = this, s = settings.plane;
    const words = `${modeName(s)}, M ${(scene.pitch / Math.abs(s)).toFixed(2)}, s ${s > 0 ? "+" : "−"}${Math.abs(s).toFixed(2)} px`;
    $("plane").value = depthOrder(s, scene.pitch);
    $("plane").setAttribute("aria-valuetext", words);
    $("plane-value").textContent = words;
    $("aperture").value = settings.aperture;
    $("aperture").disabled = settings.mode !== "focus";
    $("aperture-value").textContent = `${Math.round(100 * settings.aperture)} %`;
    const [x, y] = settings.q.map(n => Math.round((100 * n) / scene.radius));
    $("viewpoint").textContent = x || y ? `${x} %, ${y} %` : "centre";
    $("zoom").textContent = `${Math.round((100 * scene.pitch) / (frame.spacing * scene.scale))} %`;
    $("overlay").checked = settings.overlay > 0;
    $("legend").hidden = !settings.overlay;
    for (const choice of document.getElementsByName("mode")) choice.checked = choice.value === settings.mode;
  }

  // For scripts on the page: the picture as RGBA bytes, pixel (0, 0) at scene point `first`.
  pixels(width, height, first, spacing, settings = {}) {
    return this.renderer.pixels({ ...this.settings, background: [0, 0, 0], ...settings }, width, height, first, spacing);
  }

  save() {
    const { width, height, frame } = this;
    const image = new ImageData(this.pixels(width, height, frame.first(width, height), frame.spacing), width, height);
    const sheet = Object.assign(document.createElement("canvas"), { width, height });
    sheet.getContext("2d").putImageData(image, 0, 0);
    sheet.toBlob(blob => {
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: `${fileName(this.scene.title)}.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }
}

const fileName = title => title.replace(/\.[^.]*$/, "") || "view";

function showStatus(words) {
  $("status").textContent = words;
}

export async function start() {
  try {
    const scene = await loadScene(), renderer = new Renderer($("picture"), $("shader").textContent.trim(), $("prefilter").textContent.trim(), scene);
    const viewer = new Viewer(scene, renderer, $("picture"));
    await renderer.load((done, all) => showStatus(`Loading the flat, ${done} of ${all}`));
    viewer.ready = true;
    showStatus("");
    viewer.set({});
    // Keys work at once, but not where the page is a part of another.
    if (window === window.top) viewer.canvas.focus({ preventScroll: true, focusVisible: false });
    globalThis.lightField = viewer;
  } catch (error) {
    showStatus(error.message);
    throw error;
  }
}
