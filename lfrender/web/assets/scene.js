// The capture. Data files are scripts that call `lightFieldData` with their content in base64: browsers do not fetch files
// for a page that was opened from a disk.

// A page of one file has them in itself.
const received = new Map(Object.entries(globalThis.lightFieldFiles ?? {}));
globalThis.lightFieldData = (name, text, problem) => received.set(name, problem ? new Error(problem) : text);
const folder = document.body.dataset.folder;

function readFile(name) {
  return new Promise((resolve, reject) => {
    if (received.has(name)) return void resolve(received.get(name));
    const script = document.createElement("script");
    script.src = `${folder}/${name}.js`;
    script.onload = () => {
      const text = received.get(name);
      received.delete(name);
      script.remove();
      if (text === undefined) reject(new Error(`${folder}/${name}.js is damaged`));
      else if (text instanceof Error) reject(text);
      else resolve(text);
    };
    script.onerror = () => reject(new Error(`${folder}/${name}.js cannot be read; if the page was served, start 'lfrender view' again`));
    document.head.append(script);
  });
}

export function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let n = 0; n < raw.length; n++) out[n] = raw.charCodeAt(n);
  return out;
}

export const floats = text => new Float32Array(bytes(text).buffer);

export async function picture(name) {
  const blob = new Blob([bytes(await readFile(name))], { type: "image/png" });
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

export async function loadScene() {
  const scene = JSON.parse(new TextDecoder().decode(bytes(await readFile("scene.json"))));
  scene.surface.values = floats(await readFile("surface.f32"));
  // 0 where there is no depth of its own, else 1 to 255.
  scene.surface.confidence = bytes(await readFile("confidence.u8"));
  // x, y, z [m] of every grid point, where the optics of the camera are known.
  scene.surface.positions = scene.metric ? floats(await readFile("positions.f32")) : undefined;
  return scene;
}
