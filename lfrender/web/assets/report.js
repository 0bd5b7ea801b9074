// Comparison of two pictures: a line between them, and 100 %.
{
  const $ = id => document.getElementById(id);
  const compare = $("compare"), view = $("window"), sheet = $("sheet"), line = $("line");
  const source = name => document.querySelector(`#sources img[data-name="${name}"]`);
  const choices = [...document.querySelectorAll("[data-choice]")];

  // The position of the line is relative to the visible part of the picture, the cut to the whole picture.
  const seen = () => {
    const frame = view.getBoundingClientRect(), whole = sheet.getBoundingClientRect();
    const left = Math.max(frame.left, whole.left), right = Math.min(frame.left + view.clientWidth, whole.right);
    return { left, width: Math.max(right - left, 1), whole, frame };
  };
  const edge = () => seen().left + (seen().width * line.value) / 100;
  const place = () => {
    const { whole, frame } = seen();
    compare.style.setProperty("--at", `${edge() - frame.left}px`);
    compare.style.setProperty("--cut", `${Math.min(Math.max((100 * (edge() - whole.left)) / whole.width, 0), 100)}%`);
  };
  const choose = button => {
    const chosen = source(button.dataset.choice);
    $("right").src = chosen.src;
    $("right").alt = chosen.alt;
    $("name").textContent = chosen.dataset.words;
    for (const other of choices) other.setAttribute("aria-pressed", other === button);
  };
  const zoom = full => {
    const middle = [(view.scrollLeft + view.clientWidth / 2) / sheet.clientWidth, (view.scrollTop + view.clientHeight / 2) / sheet.clientHeight];
    compare.classList.toggle("full", full);
    $("full").setAttribute("aria-pressed", full);
    $("fit").setAttribute("aria-pressed", !full);
    view.scrollTo(middle[0] * sheet.clientWidth - view.clientWidth / 2, middle[1] * sheet.clientHeight - view.clientHeight / 2);
    place();
  };

  let grip;
  view.addEventListener("pointerdown", event => {
    if (event.button !== 0) return;
    const scrolls = compare.classList.contains("full") && Math.abs(event.clientX - edge()) > 24;
    grip = { scrolls, x: event.clientX, y: event.clientY };
    view.setPointerCapture(event.pointerId);
    event.preventDefault();
    if (!scrolls) follow(event);
  });
  const follow = event => {
    if (!grip) return;
    if (grip.scrolls) view.scrollBy(grip.x - event.clientX, grip.y - event.clientY);
    else line.value = (100 * (event.clientX - seen().left)) / seen().width;
    grip = { ...grip, x: event.clientX, y: event.clientY };
    place();
  };
  view.addEventListener("pointermove", follow);
  for (const name of ["pointerup", "pointercancel"]) view.addEventListener(name, () => (grip = undefined));
  view.addEventListener("scroll", place);
  addEventListener("resize", place);
  line.addEventListener("input", place);
  for (const button of choices) button.addEventListener("click", () => choose(button));
  $("fit").addEventListener("click", () => zoom(false));
  $("full").addEventListener("click", () => zoom(true));
  $("left").src = source("all_in_focus").src;
  choose(choices[0]);
  place();
}
