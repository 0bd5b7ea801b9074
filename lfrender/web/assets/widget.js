// The viewer in a notebook: its page in a frame, and the settings of both kept equal.

const SHARED = ["mode", "plane", "range", "aperture", "overlay", "brightness"];

function render({ model, el }) {
  const frame = Object.assign(document.createElement("iframe"), { srcdoc: model.get("page"), title: "Light field" });
  Object.assign(frame.style, { width: "100%", height: `${model.get("height")}px`, border: "0", borderRadius: "8px" });
  el.append(frame);
  let viewer, ours = false, wait = setInterval(() => {
    viewer = frame.contentWindow?.lightField;
    if (!viewer) return;
    clearInterval(wait);
    // What the user does in the page goes to the kernel, once he pauses.
    const set = viewer.set.bind(viewer);
    let pause;
    viewer.set = change => {
      set(change);
      if (ours) return;
      clearTimeout(pause);
      pause = setTimeout(() => {
        for (const name of SHARED) model.set(name, viewer.settings[name]);
        model.set("viewpoint", [...viewer.settings.q]);
        model.save_changes();
      }, 100);
    };
    take();
  }, 50);
  const take = () => {
    if (!viewer) return;
    const change = { q: [...model.get("viewpoint")] };
    for (const name of SHARED) if (model.get(name) != null) change[name] = model.get(name);
    ours = true;
    viewer.set(change);
    ours = false;
  };
  for (const name of [...SHARED, "viewpoint"]) model.on(`change:${name}`, take);
  return () => clearInterval(wait);
}

export default { render };
