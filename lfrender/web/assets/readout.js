// What is known about a place of the scene, in words; and the distance between two places.

import { clamp, modeName, visiblePatchSize } from "lfrender/geometry";

const signed = n => `${n > 0 ? "+" : "−"}${Math.abs(n).toFixed(2)}`;

// The place that the viewer shows at Y: its own X, patch size, confidence (0: no depth of its own) and position [m].
export function placeAt(scene, [x, y], { q, plane }) {
  const still = scene.pitch / plane, s = visiblePatchSize(scene, x, y, q, still);
  const { first, spacing, shape, confidence, positions } = scene.surface;
  // A place at virtual depth D / s is seen beside its X by the viewpoint times that depth.
  const least = scene.pitch / 12, depth = scene.pitch / (Math.abs(s) < least ? Math.sign(s || 1) * least : s);
  const own = [x - q[0] * (depth - still), y - q[1] * (depth - still)];
  const column = clamp(Math.round((own[0] - first[0]) / spacing), 0, shape[1] - 1);
  const row = clamp(Math.round((own[1] - first[1]) / spacing), 0, shape[0] - 1), at = row * shape[1] + column;
  const position = positions && [0, 1, 2].map(n => positions[3 * at + n]);
  return { own, s, depth, sure: confidence[at] / 255, position: position && position.every(Number.isFinite) ? position : undefined };
}

// Where a place of `placeAt` is seen from another viewpoint.
export function seenAt({ own, depth }, scene, { q, plane }) {
  const still = scene.pitch / plane;
  return own.map((n, k) => n + q[k] * (depth - still));
}

export function isInside({ size }, [x, y]) {
  return x >= -0.5 && y >= -0.5 && x <= size[0] - 0.5 && y <= size[1] - 0.5;
}

export function length(metres) {
  const n = Math.abs(metres);
  return n < 0.01 ? `${(1000 * n).toFixed(2)} mm` : n < 1 ? `${(1000 * n).toFixed(1)} mm` : `${n.toFixed(n < 10 ? 3 : 1)} m`;
}

// The depth of a slider in words.
export function describePlane(s, pitch, exactly) {
  const words = `${modeName(s)}, M ${(pitch / Math.abs(s)).toFixed(2)}`;
  return exactly ? `${words}, s ${signed(s)} px` : words;
}

export function describePlace(place, { pitch }) {
  if (!place.sure) return "no depth of its own here";
  const words = [describePlane(place.s, pitch, true), `${Math.round(100 * place.sure)} % sure`];
  if (place.position) words.push(`${length(place.position[2])} away`);
  return words.join(", ");
}

export function describeDistance(a, b, { pitch }) {
  if (a.position && b.position) {
    const apart = a.position.map((n, k) => b.position[k] - n);
    return `${length(Math.hypot(...apart))} apart, ${length(apart[2])} of it in depth`;
  }
  const across = Math.hypot(b.own[0] - a.own[0], b.own[1] - a.own[1]);
  const [m, n] = [a, b].map(({ s }) => (pitch / Math.abs(s)).toFixed(2));
  return `${across.toFixed(1)} px apart on the flat, from M ${m} to ${n}`;
}
