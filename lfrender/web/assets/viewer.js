// The page: its settings, and when to draw.

import { controlFlats, readAddress, writeAddress } from "lfrender/address";
import { compose, eyes } from "lfrender/composition";
import { controlPage, showSettings, showStatus } from "lfrender/controls";
import { saveFilm, savePicture } from "lfrender/files";
import { Frame, clamp, depthOrder, patchSize } from "lfrender/geometry";
import { controlPointer } from "lfrender/pointer";
import { describeDistance, describePlace, isInside, placeAt, seenAt } from "lfrender/readout";
import { Renderer } from "lfrender/renderer";
import { loadScene } from "lfrender/scene";

const SLOW = 15; // ms that a picture may take while something moves, for 60 a second; beyond, it is drawn coarser
const COARSEST = 6;
const GLIDE = 280; // ms that focus takes from one depth to another
const RANGE = 0.12; // [range of all depths] width of the sharp range at first
const HINT = "Click to focus there. Drag to look from aside.";
const $ = id => document.getElementById(id);

class Viewer {
  constructor(scene, renderer, canvas) {
    Object.assign(this, { scene, renderer, canvas });
    this.frame = new Frame(scene);
    this.settings = {
      mode: "focus", plane: scene.plane, range: this.rangeAbout(scene.plane), aperture: 1, q: [0, 0], overlay: 0, brightness: 0, stereo: "",
      background: [0, 0, 0],
    };
    // Beside this picture (A), where it is compared with another (B).
    this.other = undefined;
    this.compared = false;
    this.line = 0.5;
    this.measuring = false;
    this.marks = [];
    this.coarse = 1;
    this.moving = false;
    this.fitted = true;
    this.fromAddress();
    new ResizeObserver(() => this.resize()).observe(canvas);
    controlPage(this);
    controlPointer(this);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.set({}));
    canvas.addEventListener("webglcontextlost", () => showStatus("The graphics card was reset; reload the page."));
    this.resize();
  }

  // --- settings

  set(change) {
    cancelAnimationFrame(this.gliding);
    this.gliding = undefined;
    this.apply(change);
  }

  apply(change) {
    Object.assign(this.settings, change);
    const { scene, settings } = this, hold = near => clamp(near, ...scene.planes);
    settings.plane = patchSize(hold(depthOrder(settings.plane, scene.pitch)), scene.pitch);
    settings.range = settings.range.map(hold).sort((a, b) => a - b);
    const length = Math.hypot(...settings.q);
    if (length > scene.radius) settings.q = settings.q.map(n => (n * scene.radius) / length);
    showSettings(this);
    this.noteAddress();
    if (settings.mode === "tiles" || (this.compared && this.other?.mode === "tiles")) this.loadPlain();
    this.request();
  }

  // The ends of a sharp range about a patch size, as wide as that one is now.
  rangeAbout(plane, [low, high] = [0, RANGE * (this.scene.planes[1] - this.scene.planes[0])]) {
    const near = depthOrder(plane, this.scene.pitch), half = (high - low) / 2;
    return [near - half, near + half];
  }

  // Draw coarser while something moves, and in full when it rests.
  move(change, by = "set") {
    this.moving = true;
    clearTimeout(this.rest);
    this.rest = setTimeout(() => {
      this.moving = false;
      this.request();
    }, 160);
    this[by](change);
  }

  // Focus moves to another depth through all between.
  glide(plane) {
    const { pitch } = this.scene, from = depthOrder(this.settings.plane, pitch), to = depthOrder(plane, pitch);
    if (matchMedia("(prefers-reduced-motion: reduce)").matches || this.settings.mode === "sharp") return this.set({ plane });
    cancelAnimationFrame(this.gliding);
    let part = 0, before = performance.now();
    const step = now => {
      // Where pictures take long, it takes longer too, and still shows some on the way.
      part = clamp(part + clamp(now - before, 0, GLIDE / 4) / GLIDE, 0, 1);
      before = now;
      const eased = part * part * (3 - 2 * part);
      if (part === 1) return this.move({ plane });
      this.gliding = requestAnimationFrame(step);
      this.move({ plane: patchSize(from + (to - from) * eased, pitch) }, "apply");
    };
    this.gliding = requestAnimationFrame(step);
  }

  fromAddress() {
    const { settings, view } = readAddress(location.hash.slice(1));
    Object.assign(this.settings, settings);
    if (!view) return;
    this.fitted = false;
    Object.assign(this.frame, { middle: view.slice(0, 2), spacing: view[2] });
  }

  // Once the settings rest; not where the page is a part of another.
  noteAddress() {
    if (window !== window.top) return;
    clearTimeout(this.noting);
    this.noting = setTimeout(() => this.ready && history.replaceState(null, "", `#${writeAddress(this)}`), 250);
  }

  // --- drawing

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
    if (this.fitted) this.frame.fit(this.settings.stereo === "side" ? this.width / 2 : this.width, this.height);
    this.apply({});
  }

  // For one eye or two.
  view(stereo) {
    this.set({ stereo });
    this.resize();
  }

  request() {
    this.pending ??= requestAnimationFrame(() => {
      this.pending = undefined;
      this.draw();
    });
  }

  draw() {
    const other = this.compared ? this.comparison() : undefined, modes = [this.settings.mode, other?.mode];
    if (!this.ready || (modes.includes("tiles") && !this.renderer.textures.plainTiles)) return;
    const { canvas, frame, renderer } = this, factor = this.moving ? this.coarse : 1;
    const width = Math.max(1, Math.round(this.width / factor)), height = Math.max(1, Math.round(this.height / factor));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const spacing = (frame.spacing * this.width) / width, start = performance.now();
    const first = [frame.middle[0] - ((width - 1) / 2) * spacing, frame.middle[1] - ((height - 1) / 2) * spacing];
    const stage = getComputedStyle(canvas.parentElement).backgroundColor.match(/[\d.]+/g).slice(0, 3);
    this.settings.background = stage.map(n => n / 255);
    // With coarser pixels, one sample each: more would take the time that was saved.
    const now = settings => settings && { ...settings, background: this.settings.background, ...(factor > 1 && { most: 1 }) };
    compose(renderer, now(this.settings), width, height, first, spacing, null, now(other), this.line);
    this.drawMarks();
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

  // For scripts on the page: the picture as RGBA bytes, pixel (0, 0) at scene point `first`.
  pixels(width, height, first, spacing, settings = {}) {
    const all = { ...this.settings, background: [0, 0, 0], ...settings };
    return this.renderer.pixels(width, height, target => compose(this.renderer, all, width, height, first, spacing, target));
  }

  // --- comparison

  // What is shown right of the line: the settings kept as B, from where A is seen.
  comparison() {
    return { ...this.settings, stereo: "", ...this.other };
  }

  keep() {
    const { mode, plane, range, aperture, overlay, brightness } = this.settings;
    this.other = { mode, plane, range, aperture, overlay, brightness };
    this.compare(true);
  }

  compare(on) {
    // At first, what all this is about.
    if (on && !this.other) {
      this.other = { mode: "traditional" };
      this.settings.mode = "sharp";
    }
    this.compared = on;
    this.view(on ? "" : this.settings.stereo);
  }

  // --- focus, places, distances

  // The place under a pixel, undefined beyond the flat.
  placeUnder(u, v) {
    const { scene, settings, width } = this, half = Math.floor(width / 2), side = settings.stereo === "side";
    const seen = settings.stereo ? eyes(settings, scene.radius)[side && u >= half ? 1 : 0] : settings;
    const at = this.frame.at(side ? (u % half) + (width - half) / 2 : u, v, width, this.height);
    return isInside(scene, at) ? placeAt(scene, at, seen) : undefined;
  }

  click(u, v) {
    const place = this.placeUnder(u, v);
    if (!place) return;
    if (this.measuring) return this.mark(place);
    const { mode } = this.settings;
    showStatus(place.sure ? "" : "No depth was found here; focused at the depth of its neighbours.");
    if (mode === "range") return this.set({ range: this.rangeAbout(place.s, this.settings.range), plane: place.s });
    if (mode === "sharp" || mode === "traditional") this.set({ mode: "focus" });
    this.glide(place.s);
  }

  hover(u, v) {
    const place = u === undefined ? undefined : this.placeUnder(u, v);
    $("readout").textContent = place ? describePlace(place, this.scene) : "";
  }

  measure(on) {
    this.measuring = on;
    this.marks = [];
    showStatus(on ? "Click two places." : "");
    this.set({});
  }

  mark(place) {
    this.marks = this.marks.length === 1 ? [...this.marks, place] : [place];
    showStatus(this.marks.length === 2 ? describeDistance(...this.marks, this.scene) : "Click the second place.");
    this.set({});
  }

  drawMarks() {
    const { frame, width, height, settings, scene } = this, first = frame.first(width, height);
    const points = this.marks.map(place => seenAt(place, scene, settings).map((n, k) => (n - first[k]) / frame.spacing / devicePixelRatio));
    const circles = points.map(([x, y]) => `<circle cx="${x}" cy="${y}" r="6"/>`).join("");
    const line = points.length === 2 ? `<path d="M${points.map(point => point.join(" ")).join("L")}"/>` : "";
    $("marks").innerHTML = line + circles;
  }

  endHint() {
    if ($("status").textContent === HINT) showStatus("");
  }

  // --- zoom, viewpoint

  zoom(factor, u = (this.width - 1) / 2, v = (this.height - 1) / 2) {
    this.fitted = false;
    const full = this.scene.pitch / this.scene.scale;
    this.frame.zoom(factor, u, v, this.width, this.height, full / 8, full);
    this.move({});
  }

  full() {
    this.zoom((this.frame.spacing * this.scene.scale) / this.scene.pitch);
  }

  fit() {
    this.fitted = true;
    this.resize();
  }

  pan(du, dv) {
    this.fitted = false;
    this.frame.pan(du, dv);
    this.move({});
  }

  look(dx, dy) {
    this.move({ q: [this.settings.q[0] + dx, this.settings.q[1] + dy] });
  }

  near(step) {
    const { pitch, planes } = this.scene, by = step * (planes[1] - planes[0]);
    const plane = patchSize(clamp(depthOrder(this.settings.plane, pitch) + by, ...planes), pitch);
    this.move({ plane, range: this.settings.range.map(near => near + by) });
  }

  aperture(step) {
    this.move({ aperture: clamp(this.settings.aperture + step, 0.05, 1) });
  }

  toggle(mode) {
    this.set({ mode: this.settings.mode === mode ? "focus" : mode });
  }

  fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen();
  }

  // --- files

  save() {
    savePicture(this);
  }

  async saveFilm(kind) {
    $("film").disabled = true;
    try {
      await saveFilm(this, kind, (done, all) => showStatus(done < all ? `Drawing the film, ${done} of ${all}` : "Recording two seconds"));
      showStatus("");
    } catch (error) {
      showStatus(`The film cannot be recorded: ${error.message}`);
    }
    $("film").disabled = false;
  }
}

export async function start() {
  let viewer;
  controlFlats(() => viewer);
  try {
    const scene = await loadScene(), renderer = new Renderer($("picture"), $("shader").textContent.trim(), $("prefilter").textContent.trim(), scene);
    viewer = new Viewer(scene, renderer, $("picture"));
    await renderer.load((done, all) => showStatus(`Loading the flat, ${done} of ${all}`));
    viewer.ready = true;
    showStatus(HINT);
    viewer.apply({});
    // Keys work at once, but not where the page is a part of another.
    if (window === window.top) viewer.canvas.focus({ preventScroll: true, focusVisible: false });
    globalThis.lightField = viewer;
  } catch (error) {
    showStatus(error.message);
    for (const control of document.querySelectorAll("aside :is(input, button, select)")) control.disabled = true;
    throw error;
  }
}
