// Draws a scene with WebGL 2: textures and uniforms of light_field.frag.

import { bytes, floats, picture } from "lfrender/scene";

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;
// With this tolerance all colours are mixed: out of focus they differ.
const ANY_COLOUR = 1e3;
// Sub-samples along a pixel's side: as many as any zoom needs.
const MOST_SAMPLES = 1e3;
const NAMES = ["surface", "flatTiles", "occlusionTiles", "rings", "displacements", "shares", "averaged", "ramp", "types", "traditional"];
// Neighbouring lenses in the shader's array; it mixes at most 37, the nearest first.
const MOST_OFFSETS = 128;

export class Renderer {
  constructor(canvas, shader, prefilterShader, scene) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser offers no WebGL 2, which the viewer draws with. Try another, or switch on hardware acceleration.");
    this.gl = gl;
    this.scene = scene;
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.main = this.program(shader);
    this.prefilter = this.program(prefilterShader);
    this.canWarp = Boolean(gl.getExtension("EXT_color_buffer_float"));
    this.warp = this.canWarp && this.program(shader.replace("#version 300 es", "#version 300 es\n#define WARP"));
    this.makeTables();
  }

  program(fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(`The shader does not compile: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`The shader does not link: ${gl.getProgramInfoLog(program)}`);
    const places = {};
    for (let n = 0; n < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); n++) {
      const { name } = gl.getActiveUniform(program, n);
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  table(width, height, [internal, format, type], values) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, values);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    return { target: gl.TEXTURE_2D, texture, width, height };
  }

  makeTables() {
    const { gl, scene } = this;
    const one = [gl.R32F, gl.RED, gl.FLOAT], two = [gl.RG32F, gl.RG, gl.FLOAT];
    const [rows, columns] = scene.surface.shape, both = new Float32Array(2 * rows * columns);
    for (let n = 0; n < rows * columns; n++) {
      both[2 * n] = scene.surface.values[n];
      both[2 * n + 1] = scene.surface.confidence[n] ? 1 : 0;
    }
    const rings = floats(scene.rings.values), shares = floats(scene.types.shares);
    const displacements = floats(scene.displacements.values), kinds = Math.max(scene.types.side, 1);
    const ramp = bytes(scene.overlay.ramp);
    this.offsets = floats(scene.offsets).subarray(0, 3 * MOST_OFFSETS);
    this.textures = {
      surface: this.table(columns, rows, two, both),
      rings: this.table(rings.length / 2, 1, two, rings),
      displacements: displacements.length ? this.table(scene.displacements.shape[1], scene.displacements.shape[0], two, displacements) : this.table(1, 1, two, new Float32Array(2)),
      shares: this.table(401, shares.length / 401, one, shares),
      averaged: this.table(401, 1, one, floats(scene.averaged)),
      types: this.table(kinds, kinds, [gl.R8I, gl.RED_INTEGER, gl.BYTE], new Int8Array(scene.types.side ? scene.types.cell : [0])),
      ramp: this.table(256, 1, [gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE], ramp),
    };
    if (this.canWarp) {
      this.textures.warped = this.table(columns, rows, two, null);
      this.warpTarget = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.warpTarget);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.textures.warped.texture, 0);
      this.canWarp = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }
  }

  layers(internal, count, side, filter) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, internal, side, side, count);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, gl.CLAMP_TO_EDGE);
    return { target: gl.TEXTURE_2D_ARRAY, texture };
  }

  // Loads the flat and the depths of its pixels tile by tile; calls `progress(done, all)` after each.
  async load(progress) {
    const { gl } = this, { tiles } = this.scene, known = new Set(tiles.occlusion);
    const scratch = this.table(tiles.side, tiles.side, [gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE], null);
    this.textures.occlusionTiles = this.layers(gl.RGB8, known.size ? tiles.columns * tiles.rows : 1, known.size ? tiles.side : 1, gl.NEAREST);
    await this.loadTiles("flatTiles", async (into, layer, name) => {
      await this.upload(scratch, layer, `flat-${name}.png`);
      this.prefilterTile(scratch, into, layer);
      if (known.has(name)) await this.upload(this.textures.occlusionTiles, layer, `occlusion-${name}.png`);
    }, progress);
    gl.deleteTexture(scratch.texture);
    const [rows, columns] = this.scene.traditional.shape;
    this.textures.traditional = this.table(columns, rows, [gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE], null);
    await this.upload(this.textures.traditional, 0, "traditional.png");
  }

  // The flat without prefilter, for pictures drawn from one lens per place.
  async loadPlain(progress) {
    await this.loadTiles("plainTiles", (into, layer, name) => this.upload(into, layer, `flat-${name}.png`), progress);
  }

  async loadTiles(kind, fill, progress) {
    const { gl } = this, { tiles } = this.scene, all = tiles.columns * tiles.rows, into = this.layers(gl.RGB8, all, tiles.side, gl.LINEAR);
    for (let layer = 0; layer < all; layer++) {
      await fill(into, layer, `${layer % tiles.columns}-${Math.floor(layer / tiles.columns)}`);
      progress(layer + 1, all);
    }
    if (gl.getError() === gl.OUT_OF_MEMORY) throw new Error("The graphics card has too little memory for this flat.");
    this.textures[kind] = into;
  }

  async upload(into, layer, name) {
    const { gl } = this, bitmap = await picture(name), { width, height } = bitmap;
    gl.bindTexture(into.target, into.texture);
    if (into.target === gl.TEXTURE_2D) gl.texSubImage2D(into.target, 0, 0, 0, width, height, gl.RGB, gl.UNSIGNED_BYTE, bitmap);
    else gl.texSubImage3D(into.target, 0, 0, 0, layer, width, height, 1, gl.RGB, gl.UNSIGNED_BYTE, bitmap);
    bitmap.close();
  }

  // Sharpens a tile so that linear interpolation does not blur it.
  prefilterTile(plain, into, layer) {
    const { gl } = this, target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, into.texture, 0, layer);
    gl.viewport(0, 0, plain.width, plain.height);
    gl.useProgram(this.prefilter.program);
    this.bindTexture(this.prefilter.places.plain, 0, plain);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
  }

  // settings: mode "focus" (one plane, all lenses), "range" (places between two depths at their own, others at the nearer
  // end), "sharp" (every place at its own depth), "tiles" (one plane, the nearest lens alone) or "traditional" (the mean of
  // each microimage); plane s; range; aperture 0..1; q; overlay 0..1; brightness [EV]; `most` sub-samples along a pixel's
  // side. `first` and `spacing` place the pixels.
  // window: corner (x, y) on what is drawn into, the columns from `clip` on alone, and the colours of `mask` alone.
  draw(settings, width, height, first, spacing, target = null, window = {}) {
    const { gl, scene } = this, { pitch } = scene, sharp = settings.mode === "sharp", tiles = settings.mode === "tiles";
    const range = settings.mode === "range", wide = range || settings.mode === "focus", { x = 0, y = 0, clip, mask } = window;
    const plane = sharp ? 0 : settings.plane, q = settings.q, aside = Math.hypot(...q) > 0;
    const still = pitch / settings.plane, moved = q.map(n => n * still);
    const warped = aside && this.canWarp && (sharp || range || settings.overlay > 0) && this.warpSurface(q, still);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(x, y, width, height);
    if (mask) gl.colorMask(...mask);
    if (clip !== undefined) {
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(x + clip, y, width - clip, height);
    }
    gl.useProgram(this.main.program);
    this.set(this.main.places, {
      surfaceFirst: scene.surface.first.map((n, k) => n + (warped ? moved[k] : 0)), cell: scene.surface.spacing,
      edge: scene.surface.edge, pitch, view: q, flatSize: scene.size, tileStep: scene.tiles.side - 3, tileSide: scene.tiles.side,
      ringStep: scene.rings.step, origin: scene.origin,
      radius: scene.radius * (wide ? settings.aperture : 1), plane, between: range ? settings.range : [1, 0],
      corner: [x, y], exposure: 2 ** (settings.brightness ?? 0),
      first: first.map((n, k) => n + moved[k]), moved, spacing,
      reach: pitch * (wide ? scene.reach.wide : scene.reach.sharp), reachOwn: pitch * (aside ? scene.reach.aside : scene.reach.sharp),
      agreement: tiles ? 0 : ANY_COLOUR, agreementOwn: scene.agreement, rows: height, overlay: settings.overlay,
      most: settings.most ?? MOST_SAMPLES,
      traditionalFirst: scene.traditional.first, traditionalStep: settings.mode === "traditional" ? pitch : 0,
      limits: scene.overlay.limits, background: settings.background,
    });
    const { places } = this.main;
    gl.uniform2i(places.tileCount, scene.tiles.columns, scene.tiles.rows);
    gl.uniform3fv(places["offsets[0]"], this.offsets);
    gl.uniform1i(places.offsetCount, this.offsets.length / 3);
    gl.uniform2i(places.displacementsLow, ...scene.displacements.low);
    gl.uniform1i(places.hasOcclusion, scene.tiles.occlusion.length ? 1 : 0);
    gl.uniformMatrix2fv(places.basis, false, scene.basis.flat());
    gl.uniformMatrix2fv(places.inverseBasis, false, scene.inverse.flat());
    const instead = { surface: warped && "warped", flatTiles: tiles && "plainTiles" };
    NAMES.forEach((name, unit) => this.bind(places[name], unit, instead[name] || name));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.SCISSOR_TEST);
    gl.colorMask(true, true, true, true);
  }

  // The surface as seen from q, into the texture `warped`.
  warpSurface(q, still) {
    const { gl, scene } = this, { surface } = scene, { places } = this.warp;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.warpTarget);
    gl.viewport(0, 0, surface.shape[1], surface.shape[0]);
    gl.useProgram(this.warp.program);
    this.set(places, {
      surfaceFirst: surface.first, cell: surface.spacing, edge: surface.edge, pitch: scene.pitch, view: q, still,
      nearest: surface.virtual[0], farthest: surface.virtual[1], least: scene.pitch / 12,
    });
    this.bind(places.surface, 0, "surface");
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return true;
  }

  set(places, values) {
    const { gl } = this;
    for (const [name, value] of Object.entries(values)) {
      if (!(name in places)) continue;
      if (Array.isArray(value)) gl[`uniform${value.length}fv`](places[name], value);
      else gl.uniform1f(places[name], value);
    }
  }

  bind(place, unit, name) {
    this.bindTexture(place, unit, this.textures[name]);
  }

  bindTexture(place, unit, { target, texture }) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, texture);
    if (place) gl.uniform1i(place, unit);
  }

  // What `draw(target)` draws as RGBA bytes, top row first.
  pixels(width, height, draw) {
    const { gl } = this, buffer = gl.createRenderbuffer(), target = gl.createFramebuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, buffer);
    draw(target);
    const upward = new Uint8Array(4 * width * height), out = new Uint8ClampedArray(upward.length);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upward);
    for (let v = 0; v < height; v++) out.set(upward.subarray(4 * width * v, 4 * width * (v + 1)), 4 * width * (height - 1 - v));
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(target);
    gl.deleteRenderbuffer(buffer);
    return out;
  }
}
