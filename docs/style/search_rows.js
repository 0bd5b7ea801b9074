// On a page with tables of messages: a field that leaves only the rows in which the words typed there occur. A pasted
// message finds its row too: `…` in a row stands for any text.
document.addEventListener("DOMContentLoaded", () => {
  if (!document.querySelector("section#messages")) return;
  const tables = [...document.querySelectorAll("section#messages table")];
  const field = Object.assign(document.createElement("input"), {
    type: "search",
    className: "search-rows",
    placeholder: "Paste a message, or type a word of it",
    ariaLabel: "Search the messages of this page",
  });
  document.querySelector("section#messages h1").after(field);
  const plain = (text) => text.toLowerCase().replace(/\s+/g, " ").trim();
  // Whether all parts of a row's message, between its `…`, follow each other in what was pasted.
  const covers = (message, pasted) => {
    const parts = plain(message).split("…").map(plain).filter(Boolean);
    let at = 0;
    return parts.join("").length > 8 && parts.every((part) => {
      const found = pasted.indexOf(part, at);
      at = found + part.length;
      return found >= 0;
    });
  };
  field.addEventListener("input", () => {
    const words = plain(field.value);
    for (const table of tables) {
      const rows = [...table.querySelectorAll("tbody tr")];
      for (const row of rows) {
        row.hidden = !(plain(row.textContent).includes(words) || covers(row.cells[0].textContent, words));
      }
      table.closest("section").hidden = rows.every((row) => row.hidden);
    }
  });
});
