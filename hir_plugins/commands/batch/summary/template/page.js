"use strict";
const body = document.querySelector("#captures tbody");
const buttons = [...document.querySelectorAll("#captures th button")];
function sortBy(button) {
  const key = button.dataset.key;
  const direction = button.getAttribute("aria-sort") === "ascending" ? -1 : 1;
  buttons.forEach((other) => other.removeAttribute("aria-sort"));
  button.setAttribute("aria-sort", direction === 1 ? "ascending" : "descending");
  const rows = [...body.rows];
  const numeric = key !== "name";
  rows.sort((a, b) => {
    const [x, y] = [a.dataset[key], b.dataset[key]];
    if (x === "" || y === "") return (x === "") - (y === ""); // unknown values come last in both directions
    return direction * (numeric ? Number(x) - Number(y) : x.localeCompare(y));
  });
  rows.forEach((row) => body.append(row));
}
buttons.forEach((button) => (button.onclick = () => sortBy(button)));
const filter = document.getElementById("filter");
function applyFilter() {
  const text = filter.value.toLowerCase();
  let count = 0;
  for (const row of body.rows) {
    row.hidden = !row.textContent.toLowerCase().includes(text);
    count += !row.hidden;
  }
  document.getElementById("row-count").textContent = `${count} of ${body.rows.length}`;
}
filter.oninput = applyFilter;
applyFilter();
document.getElementById("theme").onclick = () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
};
