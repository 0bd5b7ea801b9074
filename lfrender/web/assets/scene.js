// The capture: data files are scripts that hand their content over as base64, so that a page opened from a disk, where
// browsers fetch nothing, can read them too.

const handedOver = new Map();
globalThis.lightFieldData = (name, text) => handedOver.set(name, text);

function handOver(name) {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = `data/${name}.js`;
    script.onload = () => {
      const text = handedOver.get(name);
      handedOver.delete(name);
      script.remove();
      if (text === undefined) reject(new Error(`data/${name}.js does not hold what it should`));
      else resolve(text);
    };
    script.onerror = () => reject(new Error(`data/${name}.js cannot be read`));
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
  const blob = new Blob([bytes(await handOver(name))], { type: "image/png" });
  return createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

export async function loadScene() {
  const scene = JSON.parse(new TextDecoder().decode(bytes(await handOver("scene.json"))));
  scene.surface.values = floats(await handOver("surface.f32"));
  scene.surface.resolved = bytes(await handOver("resolved.u8"));
  return scene;
}
