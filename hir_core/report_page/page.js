"use strict";
const slides = [...document.querySelectorAll(".slide")];
let current = 0;
function show(index) {
  current = (index + slides.length) % slides.length;
  slides.forEach((slide, i) => slide.classList.toggle("shown", i === current));
  document.getElementById("position").textContent = `${current + 1} of ${slides.length}`;
}
if (slides.length) {
  show(0);
  document.getElementById("previous").onclick = () => show(current - 1);
  document.getElementById("next").onclick = () => show(current + 1);
}
for (const compare of document.querySelectorAll(".compare")) {
  const range = compare.querySelector("input");
  range.oninput = () => compare.style.setProperty("--at", `${range.value}%`);
}
document.getElementById("difference").onchange = (event) =>
  document.getElementById("slides").classList.toggle("differences", event.target.checked);
document.getElementById("theme").onclick = () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
};
