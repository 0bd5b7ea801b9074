// Coordinates and depths, in the symbols of docs/geometry.md: X on the microlens plane, s, q, D.

// Grows toward the camera: telescopic s from 0 to D, then binocular s from -D to 0.
export const depthOrder = (s, pitch) => (s > 0 ? s : s + 2 * pitch);
export const patchSize = (near, pitch) => (near < pitch ? near : near - 2 * pitch);

export const modeName = s => (s > 0 ? "telescopic" : "binocular");

// Patch size at place X: linear between grid values, nearest across a depth edge (lfrender/rendering/blend_pixels.py).
export function surfaceAt(surface, x, y) {
  const [rows, columns] = surface.shape;
  const gx = clamp((x - surface.first[0]) / surface.spacing, 0, columns - 1);
  const gy = clamp((y - surface.first[1]) / surface.spacing, 0, rows - 1);
  const i = Math.min(Math.floor(gx), Math.max(columns - 2, 0)), j = Math.min(Math.floor(gy), Math.max(rows - 2, 0));
  const i1 = Math.min(i + 1, columns - 1), j1 = Math.min(j + 1, rows - 1);
  const fx = gx - i, fy = gy - j;
  const at = (v, u) => surface.values[v * columns + u];
  const a = at(j, i), b = at(j, i1), c = at(j1, i), d = at(j1, i1);
  if (Math.max(a, b, c, d) - Math.min(a, b, c, d) < surface.edge)
    return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d);
  return at(fy > 0.5 ? j1 : j, fx > 0.5 ? i1 : i);
}

// Patch size of the surface visible at Y from viewpoint q; virtual depth `still` does not move (lfrender/rendering/warped_surface.py).
export function visiblePatchSize(scene, x, y, q, still) {
  const { surface, pitch } = scene;
  const [nearest, farthest] = surface.virtual;
  const aside = Math.hypot(...q), least = pitch / 12;
  const steps = Math.max(1, Math.ceil(((farthest - nearest) * aside) / (0.5 * surface.spacing)));
  if (!aside) return surfaceAt(surface, x, y);
  let found = 0;
  for (let k = 0, before = 0; k <= steps; k++) {
    const depth = nearest + (k * (farthest - nearest)) / steps;
    found = surfaceAt(surface, x - q[0] * (depth - still), y - q[1] * (depth - still));
    const bounded = Math.abs(found) >= least ? found : found >= 0 ? least : -least;
    if (pitch / bounded <= depth) return k > 0 && Math.abs(found - before) >= surface.edge ? before : found;
    before = found;
  }
  return found;
}

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// The part of the scene that a picture of width x height pixels shows: the X of its middle and the step between pixels.
export class Frame {
  constructor(scene) {
    this.size = scene.size;
    this.middle = scene.size.map(n => (n - 1) / 2);
    this.spacing = 1;
  }

  fitted(width, height) {
    return Math.max(this.size[0] / width, this.size[1] / height);
  }

  fit(width, height) {
    this.middle = this.size.map(n => (n - 1) / 2);
    this.spacing = this.fitted(width, height);
  }

  first(width, height) {
    return [this.middle[0] - ((width - 1) / 2) * this.spacing, this.middle[1] - ((height - 1) / 2) * this.spacing];
  }

  at(u, v, width, height) {
    const [x, y] = this.first(width, height);
    return [x + u * this.spacing, y + v * this.spacing];
  }

  pan(du, dv) {
    this.middle = this.middle.map((m, k) => clamp(m - [du, dv][k] * this.spacing, 0, this.size[k] - 1));
  }

  // The place under pixel (u, v) stays under it.
  zoom(factor, u, v, width, height, smallest, full) {
    const largest = Math.max(2 * this.fitted(width, height), full);
    const spacing = clamp(this.spacing / factor, Math.min(smallest, largest), largest);
    const from = [u - (width - 1) / 2, v - (height - 1) / 2];
    this.middle = this.middle.map((m, k) => clamp(m + from[k] * (this.spacing - spacing), 0, this.size[k] - 1));
    this.spacing = spacing;
  }
}
