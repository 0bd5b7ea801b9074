// A picture, or two in one: for both eyes, or compared at a line.

// Half the distance between the eyes [radius of the microimages].
const EYE = 0.35;

// Settings of both eyes, left first, seen from about the viewpoint of `settings`.
export function eyes(settings, radius) {
  const x = Math.min(Math.max(settings.q[0], (EYE - 1) * radius), (1 - EYE) * radius);
  return [-1, 1].map(side => {
    const q = [x + side * EYE * radius, settings.q[1]], length = Math.hypot(...q);
    return { ...settings, stereo: "", q: length > radius ? q.map(n => (n * radius) / length) : q };
  });
}

// Draws `settings`; with `other`, those from the column `line` (0 to 1) on.
export function compose(renderer, settings, width, height, first, spacing, target = null, other = undefined, line = 1) {
  const both = settings.stereo ? eyes(settings, renderer.scene.radius) : [];
  if (settings.stereo === "anaglyph") {
    both.forEach((eye, n) => {
      const mask = n ? [false, true, true, true] : [true, false, false, true];
      renderer.draw(eye, width, height, first, spacing, target, { mask });
    });
  } else if (settings.stereo === "side") {
    const half = Math.floor(width / 2), middle = [first[0] + ((width - half) / 2) * spacing, first[1]];
    both.forEach((eye, n) => renderer.draw(eye, half, height, middle, spacing, target, { x: n * half }));
  } else renderer.draw(settings, width, height, first, spacing, target);
  if (other) renderer.draw(other, width, height, first, spacing, target, { clip: Math.round(line * width) });
}
